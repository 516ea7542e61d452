"""The plain model: what is left of a scenario without what docs/explanation/missions.md says missions may hold.

Planners that know no more plan for it, and are flown all the same. The bound is its bound, where that is one.
"""

from __future__ import annotations

from collections.abc import Mapping

from uavaou.errors import InputError
from uavaou.planners.base import Planner
from uavaou.scenario import Scenario

ITEMS = ("uplinks_per_slot", "energy", "failures", "failure_probability_per_slot", "devices_silent")
MEASURES = ("device_weights", "objective")  # what no planner here plans for: each keeps the paper's AoU low
_WITH_THEM = {"energy": ("swap_time_s", "stations_m")}  # fields that mean nothing without another one


def items(scenario: Scenario) -> list[str]:
    """The fields of a scenario that the plain model leaves out."""
    return [name for name in ITEMS if getattr(scenario, name) not in (None, (), 0.0)]


def plain_model(scenario: Scenario) -> Scenario:
    """Return the scenario without them."""
    dropped = [field for name in items(scenario) for field in (name, *_WITH_THEM.get(name, ()))]
    return scenario.replace(**dict.fromkeys(dropped)) if dropped else scenario


def bounded(scenario: Scenario) -> Scenario:
    """Return the plain model whose lower bound holds for a scenario.

    Capacity, batteries and failures only take possibilities away: what is flown with them can be flown without, and
    then leaves no higher AoU. With batteries, the flight-time budget holds for each sortie: the bound does without it.

    Raises:
        InputError: there are silent devices, which generate less than in the plain model.
    """
    if scenario.devices_silent:
        raise InputError(
            "devices_silent: a silent device generates no updates, so that the bound of the plain model does not hold"
        )
    return plain_model(scenario if scenario.energy is None else scenario.replace(flight_time="ignore"))


def ignored(policy: Planner, scenario: Scenario) -> list[str]:
    """The fields of a scenario that a planner does not reckon with; a learner is judged by what it was trained on."""
    lives_with = getattr(policy, "lives_with", None)
    if lives_with is None:
        return []
    fields = [name for name in items(scenario) if name not in lives_with]
    if scenario.links is not None and "links" in lives_with:  # by which it learns of losses
        fields = [name for name in fields if not name.startswith("failure")]
    return fields


def ignoring(policies: Mapping[str, Planner], scenario: Scenario) -> list[str]:
    """A line on each list of fields that some of the policies ignore, and one on those that aim at something else."""
    found: dict[tuple[str, ...], list[str]] = {}
    for name, policy in policies.items():
        if fields := tuple(ignored(policy, scenario)):
            found.setdefault(fields, []).append(name)
    lines = []
    for fields, names in found.items():
        ignore, flown = ("ignores", "it is") if len(names) == 1 else ("ignore", "they are")
        lines.append(f"{', '.join(names)} {ignore} {', '.join(fields)}: {flown} flown as far as the mission allows.")
    aims = [name for name in MEASURES if getattr(scenario, name) not in (None, "aou")]
    planned = [name for name, policy in policies.items() if hasattr(policy, "lives_with")]
    if aims and planned:
        lines.append(f"Planners keep the mean AoU of all devices low, whatever {' and '.join(aims)} may say.")
    return lines
