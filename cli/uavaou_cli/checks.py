"""Checks that are made before anything is computed, each failing with one line that names the option."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

from uavaou.errors import InputError, unknown

LARGEST_SEED = 2**32 - 1  # what NumPy's and torch's global streams take


def one_of(option: str, value: str, allowed: Iterable[str]) -> None:
    """Refuse a word that an option does not know.

    Raises:
        InputError: naming the nearest one.
    """
    if value not in allowed:
        raise unknown(option, value, allowed)


def given_path(option: str, text: str) -> Path:
    """Refuse an empty path, which would mean the present folder.

    Raises:
        InputError: naming the option.
    """
    if not text:
        raise InputError(f"{option} is empty: expected a path")
    return Path(text)


def within(option: str, value: float, lowest: float, highest: float | None = None) -> None:
    """Refuse a number outside an option's range, and one that is no number.

    Raises:
        InputError: naming the range.
    """
    if not value >= lowest:  # nan is in no range
        raise InputError(f"{option} {value}: must be at least {lowest}")
    if highest is not None and value > highest:
        raise InputError(f"{option} {value}: must be at most {highest}")


def writable_folder(path: Path) -> None:
    """Refuse a folder that cannot be written, or not be made.

    Raises:
        InputError: naming what stands in the way.
    """
    try:
        there = next(place for place in (path, *path.absolute().parents) if place.exists() or place.is_symlink())
        if not there.is_dir():
            raise InputError(f"cannot write to '{path}': '{there}' is not a folder")
        with tempfile.TemporaryFile(dir=there):  # asking for permission misses read-only file systems
            pass
    except OSError as error:
        raise InputError(f"cannot write to '{path}': {error.strerror or error}") from error


def writable_file(path: Path) -> None:
    """Refuse a file that cannot be written or replaced.

    Raises:
        InputError: naming what stands in the way.
    """
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder")
    if path.exists() and not path.is_file():  # writing replaces the target: never a device
        raise InputError(f"cannot write '{path}': it is not a regular file")
    writable_folder(path.parent)


def available_device(device: str) -> None:
    """Refuse CUDA where there is none.

    Raises:
        InputError: saying what to give instead.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise InputError("--device cuda: this machine offers no CUDA device to torch; use --device cpu or auto")
