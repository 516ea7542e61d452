"""Errors that the user can correct: the message is one line written for a person."""

import difflib
import re
import shlex
from collections.abc import Iterable

_PLAIN_WORD = re.compile(r"[\w@%+=:,./-][\w@%+=:,./~-]*", re.ASCII)  # a ~ at the beginning alone means a home folder


class InputError(ValueError):
    """A field, a file or a name that cannot be used as given.

    The command line prints the message as one line and exits with code 2. Every other exception is a bug and keeps its
    traceback.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


class InfeasibleError(InputError):
    """A scenario in which every flight breaks a constraint of the model; the message names the constraint."""


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint such as ``; did you mean 'slots'?``, or an empty string if no allowed word is near."""
    matches = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.5)
    return f"; did you mean '{matches[0]}'?" if matches else ""


def command_line(words: Iterable[object]) -> str:
    """The words of a command as one types them: quoted where a shell would read them in another way."""
    texts = map(str, words)
    return " ".join(text if _PLAIN_WORD.fullmatch(text) else shlex.quote(text) for text in texts)


def unknown(kind: str, word: str, allowed: Iterable[str]) -> InputError:
    """Return the error for a name that is not ``allowed``; it gives the nearest spelling."""
    names = list(allowed)
    return InputError(f"unknown {kind} '{word}'{nearest(word, names)} (known: {', '.join(names)})")
