"""Errors that the user can correct: the message is one line written for a person."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_MOST_FAULTS = 15  # that one message lists
_PLAIN_WORD = re.compile(r"[\w@%+=:,./-][\w@%+=:,./~-]*", re.ASCII)  # a ~ at the beginning alone means a home folder


class InputError(ValueError):
    """A field, a file or a name that cannot be used as given.

    The command line prints the message as one line and exits with code 2. Every other exception is a bug and keeps its
    traceback.

    Attributes:
        faults: where :func:`all_faults` made the error, the single errors, each without the source.
        source: of these faults.

    Examples:
        >>> from uavaou import InputError, Scenario
        >>> try:
        ...     Scenario.load("papr")
        ... except InputError as error:
        ...     print(str(error).partition(";")[0])
        unknown scenario 'papr'
    """

    faults: list[InputError]
    source: str

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))
        self.faults, self.source = [], ""

    def reworded(self, change: Callable[[str], str]) -> InputError:
        """Return the same error with every fault in other words."""
        return all_faults(self.source, [type(fault)(change(str(fault))) for fault in self.faults])

    @property
    def lines(self) -> list[str]:
        """The message for a terminal: one line, or a heading and a line for each fault."""
        if len(self.faults) < 2:
            return [str(self)]
        return [_heading(self.source, self.faults), *_listed(self.faults)]


class InfeasibleError(InputError):
    """A scenario in which every flight breaks a constraint of the model; the message names the constraint."""


def all_faults(source: str, faults: Sequence[InputError]) -> InputError:
    """Return one error for everything that is wrong with ``source``: :class:`InfeasibleError` if all faults are."""
    kind = InfeasibleError if all(isinstance(fault, InfeasibleError) for fault in faults) else InputError
    if len(faults) == 1:
        error = kind(f"{source}: {faults[0]}")
    else:
        numbered = (f"({number}) {text}" for number, text in enumerate(_listed(faults), 1))
        error = kind(f"{_heading(source, faults)}: {' '.join(numbered)}")
    error.source, error.faults = source, list(faults)
    return error


@contextmanager
def collecting(faults: list[InputError]) -> Iterator[None]:
    """Add what is wrong inside of the block to ``faults``, each with its source, and go on behind it."""
    try:
        yield
    except InputError as error:
        faults += [type(fault)(f"{error.source}: {fault}") for fault in error.faults] or [error]


def _heading(source: str, faults: Sequence[InputError]) -> str:
    return f"{source}: {len(faults)} faults"


def _listed(faults: Sequence[InputError]) -> list[str]:
    more = [f"and {len(faults) - _MOST_FAULTS} more"] if len(faults) > _MOST_FAULTS else []
    return [*map(str, faults[:_MOST_FAULTS]), *more]


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint such as ``; did you mean 'slots'?``, or an empty string if no allowed word is near."""
    matches = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def nearest_path(path: Path, shipped: Sequence[str] = ()) -> str:
    """As :func:`nearest`, for a path that leads nowhere: each part that is not there becomes the nearest one there.

    A name without a folder may be that of something ``shipped``, which comes first.
    """
    if path.parent == Path() and (hint := nearest(path.stem, shipped)):
        return hint
    found = Path(path.anchor)
    for part in path.parts[len(found.parts) :]:
        try:
            there = [part] if os.path.lexists(found / part) else os.listdir(found)
        except OSError:  # below a file, or not to be read
            there = []
        matches = difflib.get_close_matches(part, there, n=1, cutoff=0.5)
        if not matches:
            return ""
        found /= matches[0]
    return f"; did you mean '{found}'?" if found != path else ""


def command_line(words: Iterable[object]) -> str:
    """The words of a command as one types them: quoted where a shell would read them in another way."""
    texts = map(str, words)
    return " ".join(text if _PLAIN_WORD.fullmatch(text) else shlex.quote(text) for text in texts)


def unknown(kind: str, word: str, allowed: Iterable[str]) -> InputError:
    """Return the error for a name that is not ``allowed``; it gives the nearest spelling."""
    names = list(allowed)
    return InputError(f"unknown {kind} '{word}'{nearest(word, names)} (known: {', '.join(names)})")
