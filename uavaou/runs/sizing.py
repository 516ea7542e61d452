"""Which fleet keeps the data fresh enough: each one in question is rehearsed, and flown on the evaluation missions."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement, islice, product
from typing import Any, NamedTuple

import numpy as np

from uavaou.errors import InfeasibleError, InputError
from uavaou.evaluation.evaluate import play
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.fields import short
from uavaou.runs.rehearsal import Rehearsal, rehearse
from uavaou.runs.what_if import what_ifs
from uavaou.scenario import Scenario
from uavaou.statistics import Interval, interval_over_missions
from uavaou.units import MisreadText, in_own_units

MISSIONS = 32  # that each fleet flies after its rehearsal
MOST_FLEETS = 500
_MOST_SPREADS = 12  # ways to spread a fleet over stations that are all tried
_TARGET = re.compile(r"(?:(?:mean\s+)?(?:age|aou)\s*)?(?:<=?|below|of|at most)?\s*(.+)", re.IGNORECASE)


class Fleet(NamedTuple):
    """A fleet in question."""

    scenario: Scenario
    stations: tuple[tuple[float, float], ...]  # from which its UAVs start, each once, m

    @property
    def places(self) -> str:
        """Its stations in m, as a table has them, with the UAVs of each where they differ: ``0,0 x2 300,0``."""
        counts = Counter(tuple(place) for place in self.scenario.cds_m)
        alike = len(set(counts.values())) < 2
        return " ".join(f"{x:g},{y:g}" + ("" if alike else f" x{n}") for (x, y), n in counts.items())

    @property
    def cost(self) -> tuple[float, ...]:
        """What a fleet with a lower one is cheaper in: UAVs, then stations, speed and time in the air."""
        scenario = self.scenario
        return scenario.uavs, len(self.stations), scenario.speed_m_s, scenario.flight_time_budget_s


@dataclass(frozen=True)
class SizedFleet:
    """A fleet, and how fresh it keeps the data."""

    fleet: Fleet
    policy: str  # that rehearsed best
    knows: str
    ages_s: Interval  # mean AoU over the evaluation missions with its 95 % interval, s
    information: dict[str, float] = field(default_factory=dict)  # the means of Evaluation.age_of_information
    worst_loss: str = ""  # where losses were asked about: that with the largest mean, which is this one

    def row(self, target_s: float | None) -> dict[str, Any]:
        """Its row of a table."""
        scenario = self.fleet.scenario
        value, low, high = self.ages_s
        row = {
            "uavs": scenario.uavs,
            "stations": self.fleet.places,
            "speed_m_s": scenario.speed_m_s,
            "flight_time_budget_s": scenario.flight_time_budget_s,
            "policy": self.policy,
            "knows": self.knows,
            "mean_aou_slots": value / scenario.slot_length_s,
            "mean_aou_min": value / 60,
            "low_min": low / 60,
            "high_min": high / 60,
        }
        measured = {"mean_aoi_min": "mean_aoi_s", "peak_aoi_min": "peak_aoi_s"}
        row |= {name: self.information[of] / 60 for name, of in measured.items() if of in self.information}
        row |= {"late_share": self.information["late_share"]} if "late_share" in self.information else {}
        row |= {"worst_loss": self.worst_loss} if self.worst_loss else {}
        return row if target_s is None else row | {"holds": self.verdict(target_s)}

    def verdict(self, target_s: float) -> str:
        """Whether the target is held: ``yes`` with the whole interval, ``perhaps`` with a part of it, ``no``."""
        _, low, high = self.ages_s
        return "yes" if high <= target_s else "perhaps" if low <= target_s else "no"


def read_target(text: str, slot_length_s: float) -> float:
    """The mean AoU in s that a text such as ``mean AoU 10 min`` or ``40 slots`` means.

    Raises:
        InputError: it means none.
    """
    found = _TARGET.fullmatch(text.strip())
    stated = found[1] if found else ""
    if stated.endswith(("slots", "slot")):
        value = in_own_units({"slots": stated}).get("slots")
        value = value * slot_length_s if isinstance(value, int | float) else value
    else:
        value = in_own_units({"target_s": stated})["target_s"]
    if isinstance(value, MisreadText) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"--target {short(text)}: expected a mean AoU with its unit, such as 'mean AoU 10 min'")
    return float(value)


def fleets(
    scenario: Scenario,
    uavs: Sequence[int],
    stations: Sequence[tuple[float, float]] = (),
    speeds_m_s: Sequence[float] = (),
    budgets_s: Sequence[float] = (),
) -> tuple[list[Fleet], list[InputError]]:
    """The fleets of a sweep, the cheapest first, and why others cannot fly.

    A fleet is spread over the stations in every way where there are few; else it starts from one of them, or evenly
    from all. At another speed a slot is the time of a grid step, and periods and the mission keep their times.

    Args:
        scenario: what is flown.
        uavs: numbers of UAVs.
        stations: where UAVs may start, m, on the grid; none: where they do.
        speeds_m_s: to try; none: the scenario's.
        budgets_s: times in the air to try; none: the scenario's.

    Raises:
        InputError: no fleet can fly, or there are more than ``MOST_FLEETS``.
    """
    places = tuple(dict.fromkeys((x, y) for x, y in stations or scenario.cds_m))
    found: list[Fleet] = []
    problems: list[InputError] = []
    flown_at = [at_speed(scenario, speed) for speed in speeds_m_s] or [scenario]
    for number, base, budget in product(uavs, flown_at, budgets_s or (scenario.flight_time_budget_s,)):
        for spread in _spreads(places, number):
            if len(found) == MOST_FLEETS:
                raise InputError(f"more than {MOST_FLEETS} fleets: fewer numbers, stations, speeds or times in the air")
            try:
                flown = base.replace(uavs=number, cds_m=spread, flight_time_budget_s=budget)
            except InfeasibleError as error:
                problems.append(error)
                continue
            found.append(Fleet(flown, tuple(dict.fromkeys(spread))))
    if problems and not found:
        raise problems[0]
    return sorted(found, key=lambda fleet: fleet.cost), problems


def _spreads(stations: tuple[tuple[float, float], ...], uavs: int) -> Iterator[list[tuple[float, float]]]:
    """Ways to spread a fleet over stations, the station of each UAV."""
    ways = [list(way) for way in islice(combinations_with_replacement(stations, uavs), _MOST_SPREADS + 1)]
    if len(ways) <= _MOST_SPREADS:
        yield from ways
        return
    yield from ([station] * uavs for station in stations)
    yield [stations[u % len(stations)] for u in range(uavs)]


def at_speed(scenario: Scenario, speed_m_s: float) -> Scenario:
    """The scenario flown at another speed: a grid step takes another time; times in seconds stay, in whole slots."""
    ratio = speed_m_s / scenario.speed_m_s

    def slots(value: Any) -> Any:
        if isinstance(value, dict):
            return {end: slots(part) for end, part in value.items()}
        if isinstance(value, list):
            return [slots(part) for part in value]
        return max(1, round(value * ratio))

    periods = scenario.to_dict()["update_period_slots"]
    if scenario.layout == "fixed":  # else others would be drawn from a range of other slots
        periods = scenario.draw_layout().update_period.tolist()
    return scenario.replace(
        speed_m_s=speed_m_s,
        slot_length_s=scenario.slot_length_s / ratio,
        slots=max(2, round(scenario.slots * ratio)),
        update_period_slots=slots(periods),
    )


def size(
    fleets: Sequence[Fleet],
    seconds: float,
    knows: str = "everything",
    on_fleet: Callable[[int, SizedFleet | None], None] | None = None,
    what_if: Sequence[str] = (),
) -> list[SizedFleet]:
    """Rehearse each fleet in an equal share of the time, and fly its best policy on the evaluation missions.

    Args:
        fleets: those in question.
        seconds: of all rehearsals together; each needs a second or two at least.
        knows: the most that a policy may read in flight.
        on_fleet: called before each fleet with its number from 0 on, and the fleet before it.
        what_if: what happens, such as ``one UAV lost at half time``; see :func:`uavaou.runs.what_if.what_ifs`. The
            first of these losses is rehearsed, the best policy flies under each of them, and the worst counts.

    Raises:
        InputError: as :func:`uavaou.rehearse` and :func:`uavaou.runs.what_if.what_ifs`.
    """
    found: list[SizedFleet] = []
    for number, fleet in enumerate(fleets):
        if on_fleet is not None:
            on_fleet(number, found[-1] if found else None)
        cases = what_ifs(fleet.scenario, what_if)
        found.append(_flown(fleet, rehearse(cases[0][1], seconds / len(fleets), knows), cases))
    return found


def _flown(fleet: Fleet, rehearsal: Rehearsal, cases: list[tuple[str, Scenario]]) -> SizedFleet:
    served = rehearsal.served
    found = []
    for lost, scenario in cases:
        flown = play(served.policy, scenario, MISSIONS, EVALUATION_SEED, None)
        ages = interval_over_missions(flown.values("mean_aou_s"))
        measured = {name: float(values.mean()) for name, values in flown.age_of_information.items()}
        found.append(SizedFleet(fleet, served.name, served.knows, ages, measured, lost))
    return max(found, key=lambda one: one.ages_s.value)


def best_of_each_size(found: Sequence[SizedFleet]) -> dict[int, SizedFleet]:
    """Number of UAVs -> the fleet of so many with the lowest mean AoU."""
    best: dict[int, SizedFleet] = {}
    for one in found:
        uavs = one.fleet.scenario.uavs
        if uavs not in best or one.ages_s.value < best[uavs].ages_s.value:
            best[uavs] = one
    return dict(sorted(best.items()))


def cheapest(found: Sequence[SizedFleet], target_s: float) -> SizedFleet | None:
    """The cheapest fleet that holds a target with its whole interval; of equally cheap ones the freshest."""
    holding = [one for one in found if one.verdict(target_s) == "yes"]
    return min(holding, key=lambda one: (*one.fleet.cost, one.ages_s.value), default=None)


def knee(best: dict[int, SizedFleet]) -> int | None:
    """The size from which on more UAVs gain little: farthest below the line from the smallest fleet to the largest."""
    sizes = np.array(list(best), dtype=float)
    ages = np.array([one.ages_s.value for one in best.values()])
    if len(sizes) < 3 or ages[0] <= ages[-1]:
        return None
    line = ages[0] + (ages[-1] - ages[0]) * (sizes - sizes[0]) / (sizes[-1] - sizes[0])
    below = line - ages
    return int(sizes[below.argmax()]) if below.max() > 0 else None
