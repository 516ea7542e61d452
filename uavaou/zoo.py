"""The shipped YAML configurations, in the repository or inside the wheel, and the reading of such files."""

import os
from pathlib import Path
from typing import Any

from uavaou.errors import InputError, nearest, nearest_path
from uavaou.files import read_text
from uavaou.plain_yaml import parse_yaml

_MOST_BYTES = 32_000_000
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


def name_of_file(path: Path) -> str:
    """Return the name that a file gives to what it holds; bytes that are no text become question marks."""
    return path.stem.encode(errors="replace").decode()


def zoo_or_file(kind: str, source: str | Path) -> Path:
    """Return the path of a shipped configuration by name, or of a YAML file by path.

    Raises:
        InputError: no configuration has the name, or there is no such file.
    """
    name, names = str(source), zoo_names(kind)
    plurals = {"ies": "y", "ches": "ch", "s": ""}
    ending = next(plural for plural in plurals if kind.endswith(plural))
    singular = kind.removesuffix(ending) + plurals[ending]
    if name in names:
        return zoo_path(kind, name)
    looks_like_file = "/" in name or Path(name).suffix != ""
    if isinstance(source, str) and (not looks_like_file or os.path.isdir(name)):
        known = f"{', '.join(names)}; or a path ending in .yaml"
        raise InputError(f"unknown {singular} '{name[:40]}'{nearest(name, names)} ({kind}: {known})")
    if not os.path.lexists(name):
        hint = nearest_path(Path(name), names) or nearest(Path(name).stem, names)
        raise InputError(f"{singular} file '{name}' does not exist{hint}")
    return Path(name)


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """Read a YAML file that must hold a mapping with string keys.

    Raises:
        InputError: the file cannot be read, is no plain YAML, or does not hold such a mapping.
    """
    content = parse_yaml(read_text(path, _MOST_BYTES), str(path))
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        raise InputError(f"{path}: expected a mapping of field names to values, found {found}")
    for key in content:
        if not isinstance(key, str):
            raise InputError(f"{path}: field name {key!r} is not a string")
    return content
