"""One writer for a run folder."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager

from filelock import FileLock, Timeout

from uavaou.errors import InputError
from uavaou.experiments.folder import RunFolder

_PATIENCE_S = 1.0  # a writer killed a moment ago may have worker processes that are still ending


@contextmanager
def one_writer(folder: RunFolder) -> Iterator[None]:
    """Hold a run folder as its only writer.

    The operating system holds the lock for the process: it ends with it, however that ends, and the file that is
    left behind means nothing.

    Raises:
        InputError: another process writes there, or the folder cannot be written.
    """
    lock = FileLock(folder.lock)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=_PATIENCE_S)
        folder.lock.write_text(f"process {os.getpid()} on {platform.node()}\n", encoding="utf-8")
    except Timeout:
        raise InputError(f"'{folder.path}' is being written by {_holder(folder)}: wait for it, or stop it") from None
    except OSError as error:
        raise InputError(f"cannot write to '{folder.path}': {error.strerror or error}") from error
    try:
        yield
    finally:
        lock.release()


def _holder(folder: RunFolder) -> str:
    try:
        return folder.lock.read_text(encoding="utf-8")[:200].strip() or "another process"
    except (OSError, UnicodeDecodeError):
        return "another process"
