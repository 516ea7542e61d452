"""Evaluation suites: a scenario and a list of changes to it, each a point on an axis.

A suite is YAML: ``zoo_configs/suites/``, or a file of your own. Its points change the scenario or the observation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, StrictBool, field_validator, model_validator

from uavaou.algorithms.config import Observation
from uavaou.errors import InfeasibleError, InputError, nearest
from uavaou.fields import Number, short, validated
from uavaou.scenario import Scenario
from uavaou.world.coverage import best_probability
from uavaou.zoo import name_of_file, read_yaml_mapping, zoo_or_file

Text = Annotated[str, Field(min_length=1, max_length=200)]
Scale = Literal["linear", "log", "category"]


class Axis(BaseModel, frozen=True, extra="forbid"):
    """The quantity that the points differ in: the x axis of the suite's figure."""

    label: Text
    unit: str = ""
    scale: Scale = "linear"  # category: points side by side, not joined by lines

    @property
    def title(self) -> str:
        """The label with its unit."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


class Point(BaseModel, frozen=True, extra="forbid"):
    """One point: a change of the scenario, or of what the UAVs observe."""

    label: Text
    x: Number  # in the axis' unit
    set: dict[str, Any] = {}  # fields of the scenario
    observation: Observation | None = None  # None: that of each run
    joined: StrictBool = True  # false: no line leads to it in the figure, since x is only a position beside the others

    @field_validator("set", mode="before")
    @classmethod
    def _known_fields(cls, value: Any) -> Any:
        known = [name for name in Scenario.model_fields if name not in ("name", "description")] + ["radio"]
        for name in value if isinstance(value, dict) else []:
            if name in ("name", "description"):
                raise ValueError(f"a point cannot change a scenario's {name}")
            if name in cls.model_fields:
                raise ValueError(f"'{name}' is not a field of the scenario: write it beside set, not in it")
            if name not in known:
                raise ValueError(f"the scenario has no '{name}'{nearest(str(name), known)}")
        return value


class Suite(BaseModel, frozen=True, extra="forbid"):
    """A named list of points; load one with :meth:`load`."""

    name: Text
    description: Text
    scenario: Text = "paper"  # what the points change: a preset's name or a path
    axis: Axis
    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=1000)]

    @model_validator(mode="after")
    def _points_differ_and_fit_the_axis(self) -> Suite:
        labels: set[str] = set()
        for point in self.points:
            if point.label in labels:
                raise ValueError(f"points: two are labelled '{point.label}'")
            labels.add(point.label)
            if self.axis.scale == "log" and point.x <= 0:
                raise ValueError(f"axis: scale = 'log': the point '{point.label}' has x = {point.x:g}, not above 0")
        return self

    @classmethod
    def load(cls, source: str) -> Suite:
        """Load a shipped suite by name, or a YAML file by path.

        Raises:
            InputError: there is none of that name, or a field cannot be used; the message names it.
        """
        path = zoo_or_file("suites", source)
        return cls.from_dict(read_yaml_mapping(path), name_of_file(path), str(path))

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any], name: str, source: str) -> Suite:
        """Validate the content of a suite's file.

        Raises:
            InputError: naming the field, its value and what is allowed.
        """
        if "name" in fields:
            raise InputError(f"{source}: unknown field 'name': a suite has the name of its file")
        parts = dict(fields)
        if "points" in parts:
            points = parts["points"]
            if not isinstance(points, list) or not points:
                like = "- {label: '10', x: 10, set: {devices: 10}}"
                raise InputError(f"{source}: points = {short(points)}: expected a list of at least one, such as {like}")
            parts["points"] = [validated(Point, point, f"{source}: points[{k}]") for k, point in enumerate(points)]
        if "axis" in parts:
            parts["axis"] = validated(Axis, parts["axis"], f"{source}: axis")
        return validated(cls, parts | {"name": name}, source)


# -- points on a scenario ------------------------------------------------------------------------------


@dataclass(frozen=True)
class ResolvedPoint:
    """A point on a base scenario."""

    stated: Point
    scenario: Scenario | None  # None: it is infeasible
    problem: str = ""  # why it is infeasible, naming the constraint
    remark: str = ""  # why some devices cannot be served at a feasible point

    @property
    def label(self) -> str:
        """The point's label."""
        return self.stated.label

    @property
    def told(self) -> str:
        """What one should know of the point; empty where there is nothing."""
        return f"infeasible: {self.problem}" if self.problem else self.remark

    @property
    def played(self) -> Scenario:
        """The scenario of a feasible point."""
        assert self.scenario is not None
        return self.scenario


def resolve_points(suite: Suite, base: Scenario) -> list[ResolvedPoint]:
    """The points of a suite on ``base``; an infeasible one states the constraint that it breaks.

    Raises:
        InputError: ``base`` cannot take a point's change.
    """
    return [_resolve(suite, point, base) for point in suite.points]


def _resolve(suite: Suite, point: Point, base: Scenario) -> ResolvedPoint:
    try:
        scenario = base.replace(**point.set)
    except InfeasibleError as error:
        return ResolvedPoint(point, None, str(error))
    except InputError as error:
        raise InputError(f"suite '{suite.name}', point '{point.label}': {error}") from None
    if scenario.layout == "resample":  # each mission has its own link budget
        return ResolvedPoint(point, scenario)
    best = best_probability(scenario, scenario.draw_layout())  # (I,)
    hopeless = best * scenario.slots < 1  # (I,) not one success expected from hovering at the best cell for a mission
    if not hopeless.any():
        return ResolvedPoint(point, scenario)
    who = "no device can be" if hopeless.all() else f"{hopeless.sum()} of {scenario.devices} devices can never be"
    reason = (
        f"{who} served: {scenario.threshold} is met with probability "
        f"{best[hopeless].max():.2g} a slot at the best cell (constraint Rate)"
    )
    return ResolvedPoint(point, None, reason) if hopeless.all() else ResolvedPoint(point, scenario, remark=reason)
