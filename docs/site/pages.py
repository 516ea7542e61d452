"""Which files of the repository are on the documentation site, where they have the paths that they have here.

So a link that works in the repository works on the site. mkdocs calls the functions.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "*.md", "docs/*.md", "results/README.md", "results/studies/*/README.md", "results/studies/*/best/**/README.md",
    "zoo_configs/policies/*/README.md",
)  # fmt: skip
_LINK = re.compile(r"\]\(([^)\s#]+)(#[^)]*)?\)")


def links(page: Path) -> set[Path]:
    """The files and folders of the repository that a page links to."""
    targets = (target for target, _ in _LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target)
    return {(page.parent / target).resolve() for target in targets}


def on_files(files: Files, config: Any) -> Files:
    """Take the place of the files of docs/, and keep those of the theme."""
    pages = {path for pattern in PAGES for path in ROOT.glob(pattern)}
    linked = {path for page in pages for path in links(page) if path.is_file()}
    ours = [
        File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path))
        for path in sorted(pages | linked)
    ]
    docs = Path(config.docs_dir)
    theme = [file for file in files if docs not in Path(file.abs_src_path or "/").parents]
    return Files([*theme, *ours])


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to folders become plain text: a site lists none."""
    place = (ROOT / page.file.src_uri).parent
    of_folder = re.compile(r"\[([^\]]+)\]\(([^)\s#]+)\)")
    return of_folder.sub(lambda link: link[1] if (place / link[2]).is_dir() else link[0], markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Names in docstrings, such as :class:`~uavaou.World`, lose their role and the path before them."""
    return re.sub(r":[a-z]+:<code>(?:~[\w.]*\.)?([^<]*)</code>", r"<code>\1</code>", html)
