"""Scenario files that tests write, and the message of an InputError."""

from collections.abc import Callable
from pathlib import Path

import pytest

from uavaou import InputError


def refusal(action: Callable[[], object]) -> str:
    """The message of the InputError that the action ends in; one line, of a length for the number of faults."""
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    assert 0 < len(message) < 600 * len(caught.value.lines)
    return message


def write(folder: Path, text: str, name: str = "mine.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path
