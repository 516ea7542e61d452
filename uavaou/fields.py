"""Types for the fields of configurations, and pydantic's errors in one line.

All configuration files are pydantic models. Their number types refuse booleans and text.
"""

import math
import re
import reprlib
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, PlainSerializer, ValidationError

from uavaou.errors import InputError, nearest

DEVICE_COLUMNS = ("bandwidth_hz", "transmit_power_mw", "update_period_slots")  # a value, a range, or one a device


def _plain_number(value: Any) -> Any:
    """Refuse booleans and text, which pydantic would convert to numbers."""
    if isinstance(value, bool):
        raise ValueError("expected a number, not true or false")
    if isinstance(value, str):
        raise ValueError("expected a number, not text")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


# The limits are far outside of realistic values; they prevent overflows in conversions to SI units.
Number = Annotated[float, BeforeValidator(_plain_number), Field(allow_inf_nan=False, ge=-1e15, le=1e15)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Unbounded = Annotated[float, BeforeValidator(_plain_number), Field(gt=0, allow_inf_nan=False)]
Length = Annotated[Number, Field(ge=1e-3, le=1e9)]  # m
Coordinate = Annotated[Number, Field(ge=-1e9, le=1e9)]  # m
Decibels = Annotated[Number, Field(ge=-300, le=300)]
Whole = Annotated[int, BeforeValidator(_plain_number)]
PositiveWhole = Annotated[Whole, Field(ge=1, le=10**12)]
Period = Annotated[Whole, Field(ge=1, le=10**6)]  # slots
Point = tuple[Coordinate, Coordinate]


def _fits_a_folder(value: str) -> str:
    if not value or value.startswith(".") or any(c in value for c in "/\\\0"):
        raise ValueError("must be usable as a folder name: not empty, no slash, no leading dot")
    return value


FolderName = Annotated[str, AfterValidator(_fits_a_folder)]


def _numbers(value: Any) -> NDArray[Any]:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "iuf" or array.size == 0 or not np.isfinite(array).all():
        raise ValueError("expected finite numbers, in lists of the same length")
    return array


def _whole_numbers(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind == "f":
        raise ValueError("expected whole numbers")
    return array


# Lists of numbers, of any depth, as arrays; for models with arbitrary_types_allowed.
Numbers = Annotated[NDArray[Any], BeforeValidator(_numbers), PlainSerializer(lambda array: array.tolist())]
WholeNumbers = Annotated[Numbers, AfterValidator(_whole_numbers)]


def reads_schema(version: int) -> Callable[[Any], int]:
    """A validator of a file's ``schema`` that refuses every other version."""

    def check(value: Any) -> int:
        if value != version or isinstance(value, bool | float):
            raise ValueError(f"this version reads schema {version}")
        return version

    return check


_MOST_LISTED = 6  # a model with more fields does not list them in the error for an unknown one
_Model = TypeVar("_Model", bound=BaseModel)


def validated(kind: type[_Model], content: Any, source: str) -> _Model:
    """Validate a mapping.

    Raises:
        InputError: it names the field, its value and what is allowed. It has the class of the InputError that a
            validator raised.
    """
    names = [field.alias or name for name, field in kind.model_fields.items()]
    if not isinstance(content, dict):
        of = f" with {', '.join(names)}" if len(names) <= _MOST_LISTED else ""
        raise InputError(f"{source} = {short(content)}: expected a mapping{of}")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        cause = error.errors(include_url=False)[0].get("ctx", {}).get("error")
        refusal = type(cause) if isinstance(cause, InputError) else InputError
        raise refusal(f"{source}: {explain_validation(error, names)}") from None


def explain_validation(error: ValidationError, fields: list[str]) -> str:
    """Turn pydantic's report into one line on the first problem."""
    details = error.errors(include_url=False)
    # Report a misspelt field before a missing one: it is often the same field.
    unknown = [str(d["loc"][0]) for d in details if d["type"] == "extra_forbidden" and len(d["loc"]) == 1]
    if unknown:
        known = "" if len(fields) > _MOST_LISTED else f" (known: {', '.join(fields)})"
        return f"unknown field '{_shortened(unknown[0])}'{nearest(unknown[0], fields)}{known}"
    # Of the branches of a union, the one that got furthest into the value gives the most specific error.
    first = max(
        details, key=lambda d: (d["loc"][:1] == details[0]["loc"][:1], len(d["loc"]), d["type"] == "value_error")
    )
    loc = [str(part) for part in first["loc"]]
    kind, message = first["type"], _message(first)
    if not loc:
        return message
    own = [d for d in details if d["loc"][0] == loc[0]]
    misspelt = next((d for d in own if d["type"] == "extra_forbidden"), None)
    if misspelt is not None and any(isinstance(d["input"], dict) for d in own):
        key = str(misspelt["loc"][-1])
        return f"{loc[0]}: unknown key '{_shortened(key)}'{nearest(key, ('low', 'high'))} (known: low, high)"
    branches = ("float", "int", "Range", "WholeRange", "constrained", "tuple", "function")
    path = loc[0] + "".join(f"[{p}]" if p.isdigit() else f".{p}" for p in loc[1:] if not p.startswith(branches))
    if kind == "missing":
        return f"the field {path} is missing"
    several_forms = loc[0] in DEVICE_COLUMNS and len({d["loc"][1:2] for d in details}) > 1
    if several_forms and not isinstance(first["input"], int | float):
        message = "expected a number, {low: ..., high: ...} or a list with one number a device"
        message = next((_message(d) for d in own if d["type"] == "value_error"), message)
    return f"{path} = {short(first['input'])}: {message[0].lower() + message[1:]}"


def _message(detail: Any) -> str:
    """Return pydantic's message on a value in words that need no knowledge of Python."""
    kind, context = detail["type"], detail.get("ctx", {})
    plain = {
        "tuple_type": "expected a list, such as [1, 2]",
        "list_type": "expected a list, such as [a, b]",
        "dict_type": "expected a mapping, such as {name: value}",
        "model_type": "expected a mapping, such as {name: value}",
        "extra_forbidden": "unknown key",
        "bool_type": "expected true or false",
        "string_type": "expected text" + (", in quotes" if isinstance(detail["input"], bool | int | float) else ""),
    }
    if kind in plain:
        return plain[kind]
    if kind in ("too_short", "too_long"):
        least = kind == "too_short"
        count = context["min_length" if least else "max_length"]
        return f"expected at {'least' if least else 'most'} {count:,} {'value' if count == 1 else 'values'}"
    if kind == "string_too_short" and context["min_length"] == 1:
        return "must not be empty"
    message = str(detail["msg"]).removeprefix("Value error, ")
    if kind == "literal_error" and isinstance(detail["input"], str):
        message += nearest(detail["input"], re.findall("'([^']*)'", context["expected"]))
    return message


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def short(value: Any) -> str:
    """Return a value in at most 60 characters, however deep or long it is."""
    shortener = reprlib.Repr()
    shortener.maxlevel, shortener.maxstring, shortener.maxlong, shortener.maxother = 3, 40, 40, 57
    try:
        text = shortener.repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits cannot be printed
        text = f"<{type(value).__name__}>"
    return _shortened(text)
