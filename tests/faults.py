"""Faults at the file layer: in front of or behind one opening for writing, write, flush to the disk, or renaming.

A site is a kind of operation and the name of its file, such as ``rename newest.safetensors``. A trial is a site, a side
of it, and what happens there. ``--exhaustive`` asks for all trials (``make faults``); CI plays every n-th. ``--tally
FILE`` lets a later command go on with those that are left.
"""

import builtins
import errno
import io
import os
import pickle
import shutil
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from uavaou import InputError

Effect = Callable[[], None]
KILLED, STOPPED = 9, (0, 130, 143, -signal.SIGTERM)  # how a process may end that was sent SIGKILL; SIGTERM or SIGINT


def fail(code: int) -> Effect:
    """Fail with the number of an error."""

    def effect() -> None:
        raise OSError(code, os.strerror(code))

    return effect


def die() -> None:
    """End the process as SIGKILL does: nothing is cleaned up."""
    os._exit(KILLED)


def send(number: signal.Signals) -> Effect:
    return lambda: os.kill(os.getpid(), number)


ERRORS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EMFILE": errno.EMFILE, "EROFS": errno.EROFS}
EFFECTS: dict[str, Effect] = {
    "SIGKILL": die,
    "SIGTERM": send(signal.SIGTERM),
    "SIGINT": send(signal.SIGINT),
    **{name: fail(code) for name, code in ERRORS.items()},
}


class Trial(NamedTuple):
    """One fault."""

    site: str
    behind: bool  # the operation is done first
    effect: str  # a name of EFFECTS; EROFS lasts, as a disk that was mounted again to be read alone

    @property
    def is_error(self) -> bool:
        return self.effect in ERRORS


@dataclass(frozen=True)
class End:
    """How a process ended."""

    code: int  # 0, 2 for an InputError, 1 for another exception, 130 for a KeyboardInterrupt, or as it exited
    said: str  # the error, or what was written to stderr
    printed: str = ""  # to stdout


def trials(sites: Iterable[str]) -> list[Trial]:
    """Every site, on both sides, with every effect, in an order in which neighbours differ in all three."""
    found = sorted(set(sites))
    pairs = [(behind, effect) for effect in EFFECTS for behind in (False, True)]
    return [Trial(site, *pairs[(k + turn) % len(pairs)]) for turn in range(len(pairs)) for k, site in enumerate(found)]


def play(
    sites: Iterable[str], in_ci: int, one: Callable[[Trial, Path], None], place: Path, request: pytest.FixtureRequest
) -> None:
    """Play trials, each in a folder of its own, and report every finding.

    Args:
        sites: where the action writes.
        in_ci: so many trials, evenly spaced, unless all are asked for.
        one: plays a trial in an empty folder, and fails where it finds something.
        place: of the folders.
        request: of the test. With ``--tally FILE``, each trial that holds is noted there, and those noted are left out.
    """
    some = trials(sites)
    if not request.config.getoption("exhaustive"):
        some = some[:: max(len(some) // max(in_ci, 1), 1)][:in_ci]
    tally = Path(request.config.getoption("tally") or os.devnull)
    held = set(tally.read_text().splitlines()) if tally.exists() else set()
    findings = []
    for number, trial in enumerate(some):
        if (line := "\t".join((request.node.name, trial.site, str(trial.behind), trial.effect))) in held:
            continue
        (own := place / f"trial-{number}").mkdir()
        try:
            one(trial, own)
        except Exception as error:
            findings.append(f"{trial}: {error!r}")
        else:
            with tally.open("a") as file:
                file.write(line + "\n")
        shutil.rmtree(own)
    assert not findings, "\n".join([f"{len(findings)} of {len(some)} trials:", *findings])


@contextmanager
def fault(
    place: Path, site: str = "", behind: bool = False, effect: Effect = die, lasting: bool = False
) -> Iterator[list[str]]:
    """Let the first operation of a ``site`` below ``place`` have an ``effect``; yields the sites passed.

    Args:
        place: the folder whose files count.
        site: without one, nothing fails.
        behind: the operation is done first.
        effect: of the failure.
        lasting: every later operation has it too.
    """
    passed: list[str] = []
    tripped: list[str] = []

    def watched(kind: str, name: Callable[..., Any], operation: Callable[..., Any]) -> Callable[..., Any]:
        def watching(*arguments: Any, **options: Any) -> Any:
            path = name(*arguments, **options)
            if path is None or not str(path).startswith(str(place)):
                return operation(*arguments, **options)
            if tripped and lasting:
                effect()
            passed.append(f"{kind} {'tfevents' if 'tfevents' in str(path) else Path(path).name}")
            now = passed[-1] == site and not tripped
            if now:
                tripped.append(site)
            if now and not behind:
                effect()
            done = operation(*arguments, **options)
            if now and behind:
                try:
                    effect()
                except BaseException:
                    if kind == "open":
                        done.close()
                    raise
            if kind == "open":
                done.write = watched("write", lambda *_: path, done.write)
            return done

        return watching

    def written(file: Any, mode: str = "r", *_: Any, **__: Any) -> Any:
        if isinstance(file, int) or not set(mode) & set("wxa") or os.path.isdir(file):  # of files without a name
            return None
        return os.path.abspath(os.fsdecode(file))

    def flushed(fd: Any) -> str:
        return os.readlink(f"/proc/self/fd/{fd if isinstance(fd, int) else fd.fileno()}")

    def first(path: Any, *_: Any, **__: Any) -> str:
        return os.path.abspath(os.fsdecode(path))

    with pytest.MonkeyPatch.context() as patch:
        opened = watched("open", written, io.open)
        for module in (io, builtins):
            patch.setattr(module, "open", opened)
        patch.setattr(os, "fsync", watched("flush", flushed, os.fsync))
        for name, kind in {"replace": "rename", "rename": "rename", "unlink": "remove", "mkdir": "make"}.items():
            patch.setattr(os, name, watched(kind, first, getattr(os, name)))
        yield passed


def sites_of(action: Callable[[], Any], place: Path) -> list[str]:
    """Where an action writes below a place, but for locks, folders and what is only removed."""
    with fault(place) as passed:
        action()
    found = {site for site in passed if ".lock" not in site and site.split()[0] not in ("remove", "make")}
    return sorted(found)


def ended(action: Callable[[], Any], place: Path, trial: Trial) -> End:
    """How a copy of this process ends that does the ``action`` and meets the fault; an action may return its code."""
    ours, theirs = os.pipe()
    if (child := os.fork()) == 0:
        told = End(1, "the action did not end")
        try:
            sys.stdout, sys.stderr = printed, said = io.StringIO(), io.StringIO()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            effect = EFFECTS[trial.effect]
            with fault(place, trial.site, trial.behind, effect, lasting=trial.effect == "EROFS"):
                code = action()
            told = End(code if isinstance(code, int) else 0, said.getvalue(), printed.getvalue())
        except InputError as error:
            told = End(2, str(error))
        except KeyboardInterrupt:
            told = End(130, "")
        except BaseException as error:
            told = End(1, repr(error))
        finally:
            os.write(theirs, pickle.dumps(told)[:60_000])
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, "rb") as pipe:
        told = pipe.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return pickle.loads(told) if told and not code else End(code, "")


def assert_ended_well(end: End, trial: Trial, silent: bool = False) -> None:
    """It ended as the fault demands: errors in one line that names them, which is not said where it is ``silent``."""
    if trial.effect == "SIGKILL":
        assert end.code == KILLED, (trial, end)
    elif not trial.is_error:
        assert end.code in STOPPED, (trial, end)
    elif not silent:
        assert end.code == 2, (trial, end)
        assert os.strerror(ERRORS[trial.effect]) in end.said, (trial, end)
        assert end.said.strip().count("\n") == 0, (trial, end)
    else:
        assert end.code in (0, 2), (trial, end)
