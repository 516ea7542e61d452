"""The shipped YAML configurations, in the repository or inside the wheel, and reading and writing of YAML."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer

from uavaou.errors import InputError, nearest
from uavaou.files import read_text

_MOST_BYTES = 32_000_000
_MOST_NODES = 1_000_000  # a scenario of 100,000 devices has 700,000
_PACKAGE = Path(__file__).resolve().parent


def zoo_folder(kind: str) -> Path:
    """Return the folder of one kind of configuration (``scenarios``, ``algorithms``, ...)."""
    installed = _PACKAGE / "zoo_configs"  # in a wheel, the zoo is inside the package
    root = installed if installed.is_dir() else _PACKAGE.parent / "zoo_configs"
    return root / kind


def zoo_names(kind: str) -> list[str]:
    """Return the names of the shipped configurations of one kind, sorted."""
    return sorted(path.stem for path in zoo_folder(kind).glob("*.yaml"))


def zoo_path(kind: str, name: str) -> Path:
    """Return the path of the shipped configuration of one kind and name."""
    return zoo_folder(kind) / f"{name}.yaml"


def zoo_or_file(kind: str, source: str | Path) -> Path:
    """Return the path of a shipped configuration by name, or of a YAML file by path.

    Raises:
        InputError: no configuration has the name, or there is no such file.
    """
    name, names = str(source), zoo_names(kind)
    singular = kind.removesuffix("ies") + "y" if kind.endswith("ies") else kind.removesuffix("s")
    if name in names:
        return zoo_path(kind, name)
    looks_like_file = name.endswith((".yaml", ".yml")) or "/" in name
    if isinstance(source, str) and (not looks_like_file or os.path.isdir(name)):
        known = f"{', '.join(names)}; or a path ending in .yaml"
        raise InputError(f"unknown {singular} '{name[:40]}'{nearest(name, names)} ({kind}: {known})")
    if not os.path.lexists(name):
        raise InputError(f"{singular} file '{name}' does not exist{nearest(Path(name).stem, names)}")
    return Path(name)


class _PlainDumper(yaml.SafeDumper):
    """Write an object that occurs twice in full both times, without a YAML reference."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_yaml(content: Mapping[str, Any], **style: Any) -> str:
    """Return the text of a YAML file: fields in their order, no references.

    Args:
        content: plain values.
        style: PyYAML's options, such as ``width``.
    """
    text: str = yaml.dump(dict(content), Dumper=_PlainDumper, sort_keys=False, **style)
    return text


# libyaml's parser takes a fifth of the time; PyYAML may be built without it. Nodes are composed in Python either way.
_BASES: Any = (Composer, yaml.CSafeLoader) if yaml.__with_libyaml__ else (yaml.SafeLoader,)


class _BoundedLoader(*_BASES):  # type: ignore[misc]
    """PyYAML's safe loader without aliases, with which a small file could fill the memory."""

    def __init__(self, text: str) -> None:
        _BASES[-1].__init__(self, text)
        self.anchors: dict[str, yaml.Node] = {}  # of the composer
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        mark = self.peek_event().start_mark
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "aliases are not read", mark)
        self._nodes += 1
        if self._nodes > _MOST_NODES:
            raise yaml.composer.ComposerError(None, None, f"more than {_MOST_NODES:,} values", mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        return node


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """Read a YAML file that must hold a mapping with string keys.

    Raises:
        InputError: the file cannot be read, is not YAML, or does not hold such a mapping.
    """
    text = read_text(path, _MOST_BYTES)
    try:
        content = yaml.load(text, _BoundedLoader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "unreadable value"
        raise InputError(f"{path}: not valid YAML{where}: {problem}") from error
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        raise InputError(f"{path}: expected a mapping of field names to values, found {found}")
    for key in content:
        if not isinstance(key, str):
            raise InputError(f"{path}: field name {key!r} is not a string")
    return content
