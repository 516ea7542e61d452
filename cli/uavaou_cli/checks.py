"""Checks of paths and devices, made before anything is computed; each fails with one line."""

from __future__ import annotations

import tempfile
from pathlib import Path

from uavaou.errors import InputError


def given_path(option: str, text: str) -> Path:
    """Refuse an empty path, which would mean the present folder.

    Raises:
        InputError: naming the option.
    """
    if not text:
        raise InputError(f"{option} is empty: expected a path")
    return Path(text)


def writable_folder(path: Path) -> None:
    """Refuse a folder that cannot be written or made.

    Raises:
        InputError: naming the obstacle.
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
        InputError: naming the obstacle.
    """
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder")
    if path.exists() and not path.is_file():  # writing replaces the target: never a device
        raise InputError(f"cannot write '{path}': it is not a regular file")
    writable_folder(path.parent)


def available_device(device: str) -> None:
    """Refuse CUDA on a machine that has none.

    Raises:
        InputError: naming the devices to choose from.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise InputError("--device cuda: this machine offers no CUDA device to torch; use --device cpu or auto")
