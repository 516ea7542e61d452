"""Quantities as people write them, ``30 min`` or ``20 dBm``, in the unit that the name of their field states."""

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

_TEXT = re.compile(r"\s*([-+]?(?:\d+(?:[.,]\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_][^\s\d]*)\s*")
_SLOT_ROUNDING = 1e-6  # slots by which a duration may miss a whole number of them
_DEEPEST = 8  # lists and mappings inside each other
_DIGITS = 14  # what a factor adds beyond is rounding noise

_TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86_400.0}
# The ending of a field's name -> what it is, and its units: the first is the field's own, each with its factor. The
# longer endings come first. Units are read as they are spelled here: an M is no m.
UNITS: dict[str, tuple[str, dict[str, float]]] = {
    "bit_s": ("a rate", {"bit/s": 1.0, "kbit/s": 1e3, "Mbit/s": 1e6, "Gbit/s": 1e9, "bps": 1.0, "kbps": 1e3}),
    "m_s": ("a speed", {"m/s": 1.0, "km/h": 1 / 3.6, "kn": 1852 / 3600, "mph": 0.44704}),
    "s": ("a time", _TIMES),
    "m": ("a length", {"m": 1.0, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "mi": 1609.344}),
    "hz": ("a frequency", {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9}),
    "mw": ("a power", {"mW": 1.0, "W": 1e3, "uW": 1e-3, "µW": 1e-3, "dBm": 0.0}),
    "dbm": ("a power", {"dBm": 0.0, "mW": 1.0, "W": 1e3, "uW": 1e-3, "µW": 1e-3}),
    "db": ("a ratio", {"dB": 1.0, "dBi": 1.0}),
    "slots": ("slots or a time", {"slots": 1.0, "slot": 1.0} | _TIMES),
}
_IN_SLOTS = ("slots", "slot", "from", "start", "until")


class MisreadText(str):
    """Text that is no quantity of its field, and why."""

    reason: str


def in_own_units(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with each quantity that is text as a number in the unit that the name of the field ends with.

    Lists and mappings are read through; a key of a mapping may have a unit of its own. Slots may be given as a time,
    which is then a whole number of ``slot_length_s``. Text of another kind is left as it is, for the types to refuse;
    what is a quantity of a wrong kind is a :class:`MisreadText`.
    """
    length = _converted("slot_length_s", fields.get("slot_length_s"), "", None)
    slot = float(length) if isinstance(length, int | float) and 0 < length < math.inf else None
    return {name: _converted(name, value, "", slot) for name, value in fields.items()}


def _converted(name: Any, value: Any, unit: str, slot_s: float | None, depth: int = 0) -> Any:
    unit = (isinstance(name, str) and unit_of(name)) or unit
    if isinstance(value, str):
        return _quantity(value, unit, slot_s) if unit else value
    if depth == _DEEPEST:
        return value
    if isinstance(value, Mapping):
        return {key: _converted(key, part, unit, slot_s, depth + 1) for key, part in value.items()}
    if isinstance(value, list | tuple) and _holds_text(value):
        return [_converted("", part, unit, slot_s, depth + 1) for part in value]
    return value


@cache
def unit_of(name: str) -> str:
    """The key of ``UNITS`` for a field of that name; empty where it has no unit."""
    if name in _IN_SLOTS:
        return "slots"
    return next((unit for unit in UNITS if name.endswith(f"_{unit}")), "")


def _holds_text(values: Sequence[Any]) -> bool:
    """Whether there is text, or a mapping, in a list or in the lists in it: most hold many numbers alone."""
    for _ in range(_DEEPEST):
        if any(isinstance(part, str | dict) for part in values):
            return True
        values = [inner for part in values if isinstance(part, list | tuple) for inner in part]
    return False


def _quantity(text: str, unit: str, slot_s: float | None) -> Any:
    """The number that a text means, or the text where it is none."""
    found = _TEXT.fullmatch(text)
    if found is None:
        return text
    kind, units = UNITS[unit]
    own = next(iter(units))
    number, given = found.groups()
    if given not in units:
        return _misread(text, f"expected {kind}: a number of {own}, or text with one of the units {', '.join(units)}")
    if "," in number:
        return _misread(text, f"expected a number with a point: '{number.replace(',', '.')} {given}'")
    if unit == "slots":
        return _slots(text, float(number), given, slot_s)
    if given == own:
        value = float(number)
    elif own == "dBm":
        milliwatts = float(number) * units[given]
        if milliwatts <= 0:
            return _misread(text, "a power in dBm is above 0 mW")
        value = 10 * math.log10(milliwatts)
    else:
        value = 10 ** (min(float(number), 3000) / 10) if given == "dBm" else float(number) * units[given]
    return float(f"{value:.{_DIGITS}g}")


def _slots(text: str, number: float, given: str, slot_s: float | None) -> Any:
    count = number
    if given in _TIMES:
        if slot_s is None:
            return _misread(text, "a time needs slot_length_s, a number above 0")
        count = number * _TIMES[given] / slot_s
    if not count < 1e15 or round(count) < 1 or abs(count - round(count)) > _SLOT_ROUNDING * max(count, 1.0):
        of = f" of {slot_s:.6g} s" if slot_s is not None else ""
        return _misread(text, f"is {count:.6g} slots{of}, expected a whole number of slots from 1 on")
    return round(count)


def _misread(text: str, reason: str) -> MisreadText:
    misread = MisreadText(text)
    misread.reason = reason
    return misread
