"""Types for the fields of configurations, and pydantic's errors in words.

All configuration files are pydantic models. Their number types refuse booleans and text.
"""

import math
import re
import reprlib
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    create_model,
)

from uavaou.errors import InputError, all_faults, nearest
from uavaou.units import MisreadText


class Strict(BaseModel):
    """A model that does not change and refuses unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


DEVICE_COLUMNS = ("bandwidth_hz", "transmit_power_mw", "update_period_slots")  # a value, a range, or one a device


_TYPED_NUMBER = re.compile(r"\s*([-+]?\d+(?:\.\d+|,\d\d?)?(?:[eE][-+]?\d+)?)\s*[^\d\s.,]*\s*")  # not 1,000


def number_meant(text: str) -> str:
    """A hint such as ``; write 1.5`` for text that is a number with a comma, quotes or a unit; empty for other text."""
    found = _TYPED_NUMBER.fullmatch(text)
    return "" if found is None else f"; write {found[1].replace(',', '.')}"


def _plain_number(value: Any) -> Any:
    """Refuse booleans and text, which pydantic would convert to numbers."""
    if isinstance(value, bool):
        raise ValueError("expected a number, not true or false")
    if isinstance(value, str):
        reason = value.reason if isinstance(value, MisreadText) else f"expected a number, not text{number_meant(value)}"
        raise ValueError(reason)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


# The limits are far outside of realistic values; they prevent overflows in conversions to SI units.
Number = Annotated[float, BeforeValidator(_plain_number), Field(allow_inf_nan=False, ge=-1e15, le=1e15)]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Fraction = Annotated[NonNegative, Field(le=1)]
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


def validated(
    kind: type[_Model],
    content: Any,
    source: str,
    misfits: Callable[[_Model, set[str]], Iterable[InputError]] | None = None,
    also: Sequence[str] = (),
) -> _Model:
    """Validate a mapping.

    Args:
        kind: the model.
        content: the mapping.
        source: of the content, for error messages.
        misfits: finds what does not fit together in a model of which the named fields alone are sound. The validators
            of a model do not run where a field is faulty.
        also: names, beside those of the model, that the hint for an unknown field may give.

    Raises:
        InputError: it lists all faults, each with the field, its value and what is allowed. It is an InfeasibleError
            if all faults are.
    """
    names = _names(kind)
    if not isinstance(content, dict):
        of = f" with {', '.join(names)}" if len(names) <= _MOST_LISTED else ""
        raise InputError(f"{source} = {short(content)}: expected a mapping{of}")
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        faults = explain_validation(error, [*names, *also])
        faulty = {detail["loc"][0] for detail in error.errors(include_url=False) if detail["loc"]}
        if misfits is not None and faulty:
            sound = set(names) - faulty
            faults += misfits(_sound_part(kind, content, sound), sound)
        raise all_faults(source, faults) from None


def _names(kind: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in kind.model_fields.items()]


def _sound_part(kind: type[_Model], content: dict[str, Any], sound: set[str]) -> _Model:
    """A model with the sound fields alone; to read another one raises AttributeError."""
    fields: Any = {name: (field.annotation, field) for name, field in kind.model_fields.items() if name in sound}
    read = create_model("SoundPart", **fields).model_validate({name: content[name] for name in sound & content.keys()})
    return kind.model_construct(None, **{name: getattr(read, name) for name in sound})


def explain_validation(error: ValidationError, fields: list[str]) -> list[InputError]:
    """Turn pydantic's report into faults, misspelt fields first: a missing field is often one of them."""
    groups: dict[Any, list[Any]] = {}
    for detail in error.errors(include_url=False):
        groups.setdefault(detail["loc"][0] if detail["loc"] else None, []).append(detail)
    unknown, missing, wrong = [], [], []
    for field, details in groups.items():
        if field is None:  # of a validator of the model
            cause = details[0].get("ctx", {}).get("error")
            found = cause if isinstance(cause, InputError) else InputError(_message(details[0]))
            wrong += found.faults or [found]
        elif len(details[0]["loc"]) > 1 or details[0]["type"] not in ("missing", "extra_forbidden"):
            wrong += map(InputError, _faults_of_field(details))
        elif details[0]["type"] == "missing":
            missing.append(str(field))
        else:
            unknown.append(InputError(_unknown_field(str(field), fields)))
    hinted = " ".join(map(str, unknown))
    if missing := [name for name in missing if f"'{name}'" not in hinted]:
        words = "the field {} is missing" if len(missing) == 1 else "the fields {} are missing"
        wrong.append(InputError(words.format(", ".join(missing))))
    return [*unknown, *wrong]


def _unknown_field(name: str, fields: list[str]) -> str:
    known = "" if len(fields) > _MOST_LISTED else f" (known: {', '.join(fields)})"
    return f"unknown field '{_shortened(name)}'{nearest(name, fields)}{known}"


_BRANCHES = ("float", "int", "Range", "WholeRange", "constrained", "tuple", "function")  # of unions, in a place
_MODELS = ("endurance", "rotary-wing")  # of unions that have a field for it


def _faults_of_field(details: list[Any]) -> list[str]:
    """The faults in the value of one field: one, or one for each part of a list or mapping."""
    branches = {part for detail in details for part in detail["loc"][1:2] if str(part).startswith(_BRANCHES)}
    if not branches:
        return [_fault(detail) for detail in details]
    # Of the branches of a union, the one that got furthest into the value gives the most specific errors.
    furthest = max(details, key=lambda detail: (len(detail["loc"]), detail["type"] == "value_error"))
    field, branch, *within = furthest["loc"]
    misspelt = next((detail for detail in details if detail["type"] == "extra_forbidden"), None)
    if misspelt is not None and any(isinstance(detail["input"], dict) for detail in details):
        key = str(misspelt["loc"][-1])
        return [f"{field}: unknown key '{_shortened(key)}'{nearest(key, ('low', 'high'))} (known: low, high)"]
    if within or isinstance(furthest["input"], int | float) or field not in DEVICE_COLUMNS or len(branches) == 1:
        return [_fault(each) for each in details if each["loc"][1] == branch and len(each["loc"]) > len(within) + 1]
    message = "expected a number, {low: ..., high: ...} or a list with one number a device"
    return [_fault(furthest, next((_message(each) for each in details if each["type"] == "value_error"), message))]


def _fault(detail: Any, message: str = "") -> str:
    """One error of pydantic's in words: the place, the value, and what is allowed."""
    first, *rest = (str(part) for part in detail["loc"])
    inner = [part for part in rest if part not in _MODELS and not part.startswith(_BRANCHES)]
    path = first + "".join(f"[{part}]" if part.isdigit() else f".{part}" for part in inner)
    if detail["type"] == "missing":
        return f"the field {path} is missing"
    message = message or _message(detail)
    return f"{path} = {short(detail['input'])}: {message[0].lower() + message[1:]}"


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
    message = str(detail["msg"]).removeprefix("Value error, ").replace("Input should be", "must be", 1)
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
