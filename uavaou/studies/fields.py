"""The fields of a study's file, and the allowed values of each."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictBool, StrictStr

from uavaou.errors import InputError
from uavaou.evaluation.seeds import LARGEST_SEED, MOST_EPISODES
from uavaou.fields import Positive, PositiveWhole, short, validated

MOST_RUNS = 100_000
JUDGED = ("mappo", "vdn", "qmix")  # the variants that the paper's claims are about
_LONGEST_NAME = 60
_Entry = TypeVar("_Entry", bound=BaseModel)


def _seeds(value: Any) -> Any:
    """A number of seeds, or a list of them."""
    one = isinstance(value, int) and not isinstance(value, bool)
    seeds = list(range(value)) if one and 0 <= value <= MOST_RUNS else value
    if not isinstance(seeds, list) or not seeds or len(seeds) > MOST_RUNS:
        raise ValueError("expected a number of seeds, such as 5 for 0 to 4, or a list of them")
    for seed in seeds:
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed <= LARGEST_SEED:
            raise ValueError(f"expected whole numbers from 0 to {LARGEST_SEED}, not {short(seed)}")
    if len(set(seeds)) < len(seeds):
        twice = next(seed for index, seed in enumerate(seeds) if seed in seeds[:index])
        raise ValueError(f"seed {twice} stands there twice")
    return tuple(seeds)


def _slots(value: Any) -> Any:
    if value is None:
        raise ValueError("expected a number; leave it out for the published budgets")
    return value


def _expecting(kind: type[list[Any]] | type[dict[Any, Any]], example: str) -> BeforeValidator:
    """Refuse a value of another ``kind`` in the words of a YAML file."""
    word = "list" if kind is list else "mapping"

    def checked(value: Any) -> Any:
        if not isinstance(value, kind):
            raise ValueError(f"expected a {word}, such as {example}")
        return value

    return BeforeValidator(checked)


class StudySettings(BaseModel):
    """The settings that a study's file states as they are."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    description: StrictStr = ""
    seeds: Annotated[tuple[int, ...], BeforeValidator(_seeds)]  # of the trainings
    planners: Annotated[list[StrictStr], _expecting(list, "[greedy, random]")] = []  # evaluated on each scenario
    bound: StrictBool = False  # whether each scenario's certified bound is computed
    planning_seconds: Annotated[Positive, Field(le=10_000_000)] = 600.0  # of annealing, once a scenario
    episodes: Annotated[PositiveWhole, Field(le=MOST_EPISODES)] = 100  # missions of the final evaluation
    reference: StrictStr | None = None  # the variant that the report compares the others with; None: no such table
    claims: StrictBool = False  # whether the report judges the paper's claims


class StudyFile(StudySettings):
    """A study's file; the entries of ``scenarios`` and ``variants`` are validated one by one."""

    slots: Annotated[PositiveWhole | None, BeforeValidator(_slots)] = None  # of every run; None: as published
    scenarios: Annotated[list[Any], Field(min_length=1), _expecting(list, "[paper, tiny]")]
    variants: Annotated[
        dict[StrictStr, Any], Field(min_length=1), _expecting(dict, "{mappo: {}, vdn: {set: {gamma: 0.9}}}")
    ]


class ScenarioEntry(BaseModel):
    """An entry of ``scenarios`` that changes one or names it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: StrictStr
    set: Annotated[dict[StrictStr, Any], _expecting(dict, "{uavs: 3, layout_seed: 1}")] = {}
    name: StrictStr | None = None


class VariantEntry(BaseModel):
    """An entry of ``variants``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    algorithm: StrictStr | None = None  # None: that of the variant's name
    set: Annotated[dict[StrictStr, Any], _expecting(dict, "{gamma: 0.9}")] = {}
    against: StrictStr | None = None  # the variant that the report compares it with, beside the reference


def validated_entry(kind: type[_Entry], content: Any, source: str, settings: str) -> _Entry:
    """Validate an entry of ``scenarios`` or ``variants``; ``settings`` names what belongs below its ``set``.

    Raises:
        InputError: naming the field, its value and what is allowed.
    """
    try:
        return validated(kind, content, source)
    except InputError as error:
        hint = f"; {settings} go below set" if "unknown field" in str(error) else ""
        raise InputError(f"{error}{hint}") from None


def usable_name(name: str, source: str) -> str:
    """Refuse a name that cannot name a folder and fill a table cell; returns it.

    Raises:
        InputError: saying what is expected.
    """
    usable = name.isprintable() and name == name.strip() and not name.startswith(".") and not set(name) & set("/\\")
    if not usable or not 0 < len(name) <= _LONGEST_NAME:
        raise InputError(
            f"{source} = {short(name)}: expected 1 to {_LONGEST_NAME} characters, no slash and no leading dot"
        )
    return name
