"""Failures at the file layer: in front of or behind one opening for writing, flush to the disk, or renaming.

A site is a kind of operation and the name of its file, such as ``rename newest.safetensors``.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

ERRORS = (errno.ENOSPC, errno.EIO, errno.EMFILE)
Effect = Callable[[], None]


def fail(code: int) -> Effect:
    """Fail with the number of an error."""

    def effect() -> None:
        raise OSError(code, os.strerror(code))

    return effect


def die() -> None:
    """End the process as SIGKILL does: nothing is cleaned up."""
    os._exit(9)


@contextmanager
def fault(place: Path, site: str = "", behind: bool = False, effect: Effect = die, nth: int = 1) -> Iterator[list[str]]:
    """Let the ``nth`` operation of a ``site`` below ``place`` have an ``effect``; yields the sites passed.

    Args:
        place: the folder whose files count.
        site: without one, nothing fails.
        behind: the operation is done first.
        effect: of the failure.
        nth: occurrence, from 1.
    """
    passed: list[str] = []

    def watched(kind: str, name: Callable[..., Any], operation: Callable[..., Any]) -> Callable[..., Any]:
        def watching(*arguments: Any, **options: Any) -> Any:
            path = name(*arguments, **options)
            if path is None or not str(path).startswith(str(place)):
                return operation(*arguments, **options)
            passed.append(f"{kind} {Path(path).name}")
            now = passed[-1] == site and passed.count(site) == nth
            if now and not behind:
                effect()
            done = operation(*arguments, **options)
            if now and behind:
                if kind == "open":
                    done.close()
                effect()
            return done

        return watching

    def written(file: Any, mode: str = "r", *_: Any, **__: Any) -> Any:
        if isinstance(file, int) or not set(mode) & set("wxa") or os.path.isdir(file):  # of files without a name
            return None
        return os.path.abspath(file)

    def flushed(fd: Any) -> str:
        return os.readlink(f"/proc/self/fd/{fd if isinstance(fd, int) else fd.fileno()}")

    with pytest.MonkeyPatch.context() as patch:
        opened = watched("open", written, io.open)
        for module in (io, builtins):
            patch.setattr(module, "open", opened)
        patch.setattr(os, "fsync", watched("flush", flushed, os.fsync))
        for name in ("replace", "rename"):
            patch.setattr(
                os, name, watched("rename", lambda source, *_, **__: os.path.abspath(source), getattr(os, name))
            )
        yield passed


def killed(action: Callable[[], Any], place: Path, site: str, behind: bool, nth: int = 1) -> bool:
    """Whether a copy of this process that does the ``action`` is killed at the site."""
    if (child := os.fork()) == 0:
        try:
            sys.stdout = sys.stderr = io.StringIO()
            with fault(place, site, behind, die, nth):
                action()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
