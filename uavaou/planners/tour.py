"""Tours: the fleet goes round and round a closed way that passes every device closely enough.

A close-enough travelling salesman (:mod:`uavaou.planners.close_enough`) passes every device where it is in range
likely enough. ``tour`` spaces the UAVs evenly in time on one tour, which for the largest latency is within
2 (1 - 1/k) of the best cyclic schedule of k agents (Afshani et al., 2022); ``partition-tour`` cuts it into parts and
lays a tour for each UAV over the devices of its part. A UAV dwells at a stop as long as that lowers the exact
expected age of all its rounds; how likely is likely enough is what gives the lowest.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from uavaou.planners.close_enough import close_enough_tours
from uavaou.planners.plan import Plan, Progress, Report, RoutePlanner
from uavaou.planners.search import Expectation, expect, mean_aou_s, refresh, total_age
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# P(R >= R_min) at a stop that serves a device, as a share of the best that any cell offers; each is tried.
_LIKELY = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


class _Rounds(RoutePlanner):
    """Tours for one coverage of the devices after the other, with dwelling; the best of them."""

    def plan(self, scenario: Scenario, layout: Layout, report: Report | None = None) -> Plan:
        """Lay the tours; see :class:`RoutePlanner`. A time limit is for searching on after the tours laid without."""
        probability = coverage_probability(scenario, layout).mean(axis=0)  # (X, Y, I)
        best = probability.max(axis=(0, 1))  # (I,)
        routes = np.tile(Flight(scenario).cds, (scenario.slots, 1, 1))  # (K, U, 2); stays where nobody is in reach
        expectation = expect(scenario, layout, routes)
        least, interrupted = total_age(expectation), False
        rounds = len(_LIKELY) * (1 if self.time_limit_s is None else 2)
        try:
            coverages = [(probability >= likely * best) & (best > 0.0) for likely in _LIKELY if best.any()]
            for done, tours in enumerate(self._all_tours(scenario, coverages), start=1):
                found, age = _dwelt(scenario, expectation, tours)
                routes, least = (found, age) if age < least else (routes, least)
                if report is not None:
                    report(Progress(done / rounds, scenario.slot_length_s * least / scenario.slots))
        except KeyboardInterrupt:
            interrupted = True
        return Plan(self.name, routes, mean_aou_s(scenario, layout, routes), interrupted=interrupted)

    def _all_tours(self, scenario: Scenario, coverages: list[Bools]) -> Iterator[list[Ints]]:
        """The tours of each coverage in turn; under a time limit once more, searched on for that long."""
        if coverages:
            yield from self._tours(scenario, coverages, None)
            if self.time_limit_s is not None:
                yield from self._tours(scenario, coverages, self.time_limit_s)

    @abstractmethod
    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        """For each coverage (X, Y, I) the stops of its tours, (S, 2) each: one for the whole fleet, or one per UAV."""


class Tour(_Rounds):
    """One tour, the UAVs spaced evenly in time."""

    name: ClassVar[str] = "tour"

    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        return [[cells] for cells, _ in close_enough_tours(coverages, time_limit_s)]


class PartitionTour(_Rounds):
    """The tour cut into one part for each UAV, about as long each, and a tour over the devices of each part."""

    name: ClassVar[str] = "partition-tour"

    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        half = None if time_limit_s is None else time_limit_s / 2
        parts: list[list[Bools]] = []  # of each coverage, (X, Y, devices of the part) each
        for served, (cells, device) in zip(coverages, close_enough_tours(coverages, half), strict=True):
            part = _cut(cells, scenario.uavs)  # (V,)
            parts.append([served[..., device[part == own]] for own in np.unique(part)])
        tours = iter(close_enough_tours([served for own in parts for served in own], half))
        cds = Flight(scenario).cds  # (U, 2)
        return [_shared_out([next(tours)[0] for _ in own], cds) for own in parts]


def _shared_out(tours: list[Ints], cds: Ints) -> list[Ints]:
    """A tour (S, 2) for each UAV, nearest to its CDS (U, 2) on the whole; one without a tour stays there."""
    way = np.array([[np.abs(tour - home).sum(axis=1).min() for tour in tours] for home in cds])  # (U, tours)
    of_uav = dict(zip(*(found.tolist() for found in linear_sum_assignment(way)), strict=True))
    return [tours[of_uav[u]] if u in of_uav else cds[u : u + 1] for u in range(len(cds))]


def _cut(cells: Ints, parts: int) -> Ints:
    """The part, counted from 0, that each stop of a tour (V, 2) belongs to; parts are runs about as long each."""
    legs = np.abs(cells - np.roll(cells, -1, axis=0)).sum(axis=1)  # (V,) grid steps to the next
    reached = np.cumsum(legs) - legs  # (V,)
    part: Ints = reached * parts // max(int(legs.sum()), 1)
    return part


def _dwelt(scenario: Scenario, expectation: Expectation, tours: list[Ints]) -> tuple[Ints, float]:
    """Routes (K, U, 2) over the tours with the slots at each stop that a descent one by one ends at, and their age.

    Args:
        scenario: whose rules of flight hold.
        expectation: of any routes; room to work in.
        tours: stops (S, 2), one tour for the whole fleet or one for each UAV.
    """
    dwell = [np.ones(len(tour), dtype=np.int64) for tour in tours]  # slots at each stop, (S,) each
    routes = laid(scenario, tours, dwell)
    least, improved = _age(scenario, expectation, routes), True
    while improved:
        improved = False
        for slots, stop in [(one, stop) for one in dwell for stop in range(len(one))]:
            slots[stop] += 1
            longer = laid(scenario, tours, dwell)
            age = _age(scenario, expectation, longer)
            if age < least:
                routes, least, improved = longer, age, True
            else:
                slots[stop] -= 1
    return routes, least


def _age(scenario: Scenario, expectation: Expectation, routes: Ints) -> float:
    """The total age of ``routes`` (K, U, 2), without computing the coverage anew."""
    expectation.routes[:, 1:] = (routes[..., 0] * scenario.rows + routes[..., 1]).T  # row 0 is the CDS for all
    refresh(expectation)
    return total_age(expectation)


def laid(scenario: Scenario, tours: list[Ints], dwell: list[Ints]) -> Ints:
    """Routes (K, U, 2) round the tours; on one for all, UAV u is u/U of its slots ahead."""
    loops = [_loop(stops, slots) for stops, slots in zip(tours, dwell, strict=True)]
    if len(loops) == 1:
        ahead = np.arange(scenario.uavs) * len(loops[0]) // scenario.uavs
        loops = [np.roll(loops[0], -offset, axis=0) for offset in ahead]
    flight = Flight(scenario)
    return np.stack([ride(flight, scenario.slots, u, loop) for u, loop in enumerate(loops)], axis=1)


def _loop(stops: Ints, dwell: Ints) -> Ints:
    """The cells of one round over the stops (S, 2) with ``dwell`` (S,) slots at each, (L, 2)."""
    round_trip = pairwise([*stops, stops[0]])
    cells = []
    for (here, there), slots in zip(round_trip, dwell, strict=True):
        cells += [np.tile(here, (slots, 1)), _way(here, there)[:-1]]
    return np.concatenate(cells)


def _way(here: Ints, there: Ints) -> Ints:
    """The cells after ``here`` up to ``there``, along x first, (n, 2)."""
    (along_x, along_y), direction = np.abs(there - here), np.sign(there - here)
    steps = np.repeat(np.diag(direction), [along_x, along_y], axis=0)  # (n, 2)
    way: Ints = here + np.cumsum(steps, axis=0)
    return way


def ride(flight: Flight, slots: int, uav: int, loop: Ints) -> Ints:
    """The route of a UAV that is at ``loop[t mod L]`` in slot t from as soon to as late as its rules allow, (K, 2)."""
    home, slot = flight.cds[uav], np.arange(slots + 1)
    at = loop[slot % len(loop)]  # (K+1, 2)
    away = np.abs(at - home).sum(axis=1)  # (K+1,) grid steps from and to the CDS
    route = np.tile(home, (slots + 1, 1))  # (K+1, 2) row t is slot t
    on_time = np.flatnonzero(away < slot)
    if not len(on_time):
        return route[1:]
    meeting = int(on_time[0])
    flown = np.cumsum(np.abs(np.diff(at[meeting:], axis=0)).sum(axis=1))  # (K-meeting,)
    flown = away[meeting] + np.concatenate([[0], flown])  # (K-meeting+1,) up to slots meeting to K
    home_in_time = (flown + away[meeting:] <= flight.budget[uav]) & (away[meeting:] <= slots - slot[meeting:])
    end = meeting + int(np.append(home_in_time, False).argmin())  # the first slot elsewhere
    if end == meeting:
        return route[1:]
    route[meeting:end] = at[meeting:end]
    for way, first in ((_way(home, at[meeting])[:-1], meeting - away[meeting] + 1), (_way(at[end - 1], home), end)):
        route[first : first + len(way)] = way
    return route[1:]
