"""Atomic writes, bounded reads, and checks of folders from untrusted sources."""

import gzip
import json
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from uavaou.errors import InputError, nearest_path


class PathIn:
    """A path below the ``path`` of the object that has it: ``config = PathIn("config.yaml")``."""

    def __init__(self, *parts: str) -> None:
        self._parts = parts

    def __get__(self, folder: Any, kind: type) -> Path:
        path: Path = folder.path.joinpath(*self._parts)
        return path


@contextmanager
def replacing(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open a file that replaces ``path`` atomically, after it has reached the disk, if the block ends without error.

    If the block raises, ``path`` stays as it was. Text is UTF-8.

    Args:
        path: the file to replace or to create.
        mode: ``w`` or ``wb``.

    Raises:
        OSError: the file cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    partial.unlink(missing_ok=True)  # left by a killed process
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
    try:
        with partial.open(mode.replace("w", "x"), encoding=encoding, newline=newline) as file:
            yield file
            flush_to_disk(file)
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a failure to write ``path``, a file or a folder, into an :class:`InputError`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from error


def flush_to_disk(file: IO[Any]) -> None:
    """Wait until the written data would survive a loss of power."""
    file.flush()
    os.fsync(file.fileno())


def refuse_links(folder: Path) -> None:
    """Refuse a folder with links, pipes or devices, through which a write could reach another place.

    Raises:
        InputError: it names the link, pipe or device.
    """
    if not folder.is_dir():
        return
    try:
        for entry in os.scandir(folder):
            kind = entry.stat(follow_symlinks=False).st_mode
            if stat.S_ISDIR(kind):
                refuse_links(Path(entry.path))
            elif not stat.S_ISREG(kind):
                what = "a symbolic link" if stat.S_ISLNK(kind) else "no regular file"
                raise InputError(f"'{entry.path}' is {what}: a run folder holds plain files and folders alone")
    except OSError as error:
        raise InputError(f"'{folder}' cannot be read: {error.strerror or error}") from error


def folder_name(name: str) -> str:
    """Return a name given by a user, such as that of a variant, as a file name; ``unquote`` reverses it."""
    return quote(name, safe=" +=,.-_~()")


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most ``most_bytes``, also unpacked where its name ends in ``.gz``.

    Raises:
        InputError: the file cannot be read, is no regular file, or is larger.
    """
    try:
        state = path.stat()
        if not stat.S_ISREG(state.st_mode):
            what = "a folder" if stat.S_ISDIR(state.st_mode) else "not a regular file"
            raise InputError(f"{path}: cannot be read: it is {what}")
        if state.st_size > most_bytes:
            raise InputError(f"{path}: {state.st_size:,} bytes, at most {most_bytes:,} are read")
        if path.suffix != ".gz":
            return path.read_bytes()
        with gzip.open(path) as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            raise InputError(f"{path}: more than {most_bytes:,} bytes when unpacked, at most so many are read")
        return content
    except InputError:
        raise
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: it is damaged, or not packed by gzip") from error
    except (OSError, ValueError) as error:
        hint = nearest_path(path) if isinstance(error, FileNotFoundError) else ""
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}{hint}") from error


def read_text(path: Path, most_bytes: int) -> str:
    """Read a UTF-8 text file as :func:`read_bytes` does; its line ends become ``\n``.

    Raises:
        InputError: as there, or the file is not UTF-8.
    """
    try:
        text = read_bytes(path, most_bytes).decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: it is not UTF-8 text: save it as UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path, most_bytes: int = 512_000_000) -> Any:
    """Read a JSON file of at most ``most_bytes``.

    Raises:
        InputError: as :func:`read_text`, or the file is not JSON.
    """
    text = read_text(path, most_bytes)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as JSON: {error}") from error


def write_text(path: Path, text: str) -> None:
    """Replace a text file, and make its folder.

    Raises:
        InputError: the file cannot be written.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            file.write(text)


def write_json(path: Path, content: Any) -> None:
    """Replace a JSON file as :func:`write_text` does."""
    write_text(path, json.dumps(content, indent=1) + "\n")
