"""Scenario files that tests write, and the message of an InputError."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

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


# All that a small mission may hold (docs/operations.md).
EVERYTHING: dict[str, Any] = {
    "uplinks_per_slot": 1, "energy": {"endurance_s": 80}, "swap_time_s": 10, "links": {"probability": 0.5},
    "failures": [{"uav": 1, "slot": 3, "until": 6}], "failure_probability_per_slot": 0.05, "silence_slots": 2,
    "devices_silent": [{"device": 0, "from": 5}], "wind": {"east_m_s": 2, "deviation_m_s": 1}, "age_limit_s": 30,
    "objective": "peak",
}  # fmt: skip
