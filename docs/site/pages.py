"""Which files of the repository are on the documentation site, where they have the paths that they have here.

So a link that works in the repository works on the site. mkdocs calls the functions.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *("*.md", "docs/**/*.md", "results/README.md", "results/studies/*/README.md"),
    *("results/studies/*/best/**/README.md", "zoo_configs/policies/*/README.md", "docs/site/*.css"),
)
NOTES = ROOT / "docs" / "notes"  # for those who change the project
GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"
TERMS = re.findall(r"^\| (?!term|---)([\w ]+) \|", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
_LINK = re.compile(r"\]\(([^)\s#]+)(#[^)]*)?\)")


def links(page: Path) -> set[Path]:
    """The files and folders of the repository that a page links to."""
    targets = (target for target, _ in _LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target)
    return {(page.parent / unquote(target)).resolve() for target in targets}


def on_files(files: Files, config: Any) -> Files:
    """Take the place of the files of docs/, and keep those of the theme."""
    pages = {path for pattern in PAGES for path in ROOT.glob(pattern) if not _is_left_out(path)}
    linked = {path for page in pages for path in links(page) if path.exists() and not _is_left_out(path)}
    ours = [
        File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path))
        for path in sorted(pages | linked)
    ]
    docs = Path(config.docs_dir)
    theme = [file for file in files if docs not in Path(file.abs_src_path or "/").parents]
    return Files([*theme, *ours])


def _is_left_out(path: Path) -> bool:
    """Whether the site lacks it: a site lists no folders."""
    return path.is_dir() or NOTES in path.parents


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to what the site lacks become plain text, and the first use of each term a link to the glossary."""
    path = ROOT / page.file.src_uri
    of_file = re.compile(r"\[([^\]]+)\]\(([^)\s#]+)(?:#[^)\s]*)?\)")
    text = of_file.sub(lambda link: link[1] if _is_left_out((path.parent / link[2]).resolve()) else link[0], markdown)
    if path == GLOSSARY:
        return re.sub(
            rf"^\| ({'|'.join(TERMS)}) \|",
            lambda row: f'| <span id="{_id(row[1])}">{row[1]}</span> |',
            text,
            flags=re.M,
        )
    return with_terms(text, os.path.relpath(GLOSSARY, path.parent))


def _id(term: str) -> str:
    return term.lower().replace(" ", "-")


def _forms(term: str) -> str:
    """A pattern for a term: also its plural, and with a capital where a sentence begins."""
    forms = f"{term[:-1]}(?:y|ies)" if term.endswith("y") else f"{term}s?"
    return forms if term != term.lower() else f"(?i:{forms})"


_KEPT = (  # where no term is linked
    *(r"^```.*?^```", r"`[^`\n]*`", r"^#[^\n]*", r"^:::[^\n]*", r"<code>.*?</code>", r"<[^>]*>", r'"[^"\n]*"'),
    *(r"\[!\[[^\]]*\]\([^)]*\)\]\([^)]*\)", r"\[[^\]]*\]\([^)]*\)"),
)
_WORDS = re.compile(
    "|".join([*_KEPT, *(rf"(?<![\w-])({_forms(term)})(?![\w-])" for term in TERMS)]), re.DOTALL | re.MULTILINE
)


def with_terms(text: str, glossary: str) -> str:
    """A page on which the first use of each term is a link."""
    met: set[int] = set()

    def link(found: re.Match[str]) -> str:
        number = found.lastindex
        if number is None or number in met:
            return found[0]
        met.add(number)
        return f"[{found[0]}]({glossary}#{_id(TERMS[number - 1])})"

    return _WORDS.sub(link, text)


def on_page_content(html: str, **_: Any) -> str:
    """Names in docstrings, such as :class:`~uavaou.World`, lose their role and the path before them."""
    return re.sub(r":[a-z]+:<code>(?:~[\w.]*\.)?([^<]*)</code>", r"<code>\1</code>", html)
