"""One writer at a time for the folder of a run or of a study."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from uavaou.errors import InputError

LOCK = ".lock"  # the file that the writer of a folder holds
_PATIENCE_S = 1.0  # a writer killed a moment ago may have worker processes that are still ending


class HeldError(InputError):
    """Another process holds the folder; ``by`` says which, as in "process 12 on host"."""

    def __init__(self, folder: Path, by: str) -> None:
        super().__init__(f"'{folder}' is being written by {by}: wait for it, or stop it")
        self.by = by


@contextmanager
def one_writer(folder: Path) -> Iterator[None]:
    """Hold a folder as its only writer, by a lock on the file ``.lock`` in it.

    The operating system holds the lock for the process: it ends with it, however that ends, and the file that is
    left behind means nothing.

    Raises:
        HeldError: another process writes there.
        InputError: the folder cannot be written.
    """
    path = folder / LOCK
    lock = FileLock(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=_PATIENCE_S)
        path.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="utf-8")
    except Timeout:
        raise HeldError(folder, _stated(path)) from None
    except OSError as error:
        raise InputError(f"cannot write to '{folder}': {error.strerror or error}") from error
    try:
        yield
    finally:
        lock.release()


def holder(path: Path) -> str | None:
    """Who holds the lock on the file ``path``; None where nobody does."""
    if not path.is_file():
        return None
    try:
        with FileLock(path, timeout=0):
            return None
    except Timeout:
        return _stated(path)
    except OSError:  # read-only: nobody writes here either
        return None


def _stated(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")[:200].strip() or "another process"
    except (OSError, UnicodeDecodeError):
        return "another process"
