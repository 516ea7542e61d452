"""Tours: the fleet goes round and round a closed way that passes every device closely enough.

A close-enough travelling salesman: stops are chosen so that from one of them each device is in range likely enough
(greedy set cover), ordered by nearest neighbour, improved by 2-opt and Or-opt, and slid to cells that shorten the
way. ``tour`` spaces the UAVs evenly in time on one tour, which for the largest latency is within 2 (1 - 1/k) of the
best cyclic schedule of k agents (Afshani et al., 2022); ``partition-tour`` cuts it into a tour for each UAV.
"""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from uavaou.planners.plan import Plan, Report, RoutePlanner
from uavaou.planners.search import mean_aou_s
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_LIKELY = 0.8  # P(R >= R_min) at a stop that serves a device, or this share of the best that any cell offers


class Tour(RoutePlanner):
    """One tour, the UAVs spaced evenly in time."""

    name: ClassVar[str] = "tour"

    def plan(self, scenario: Scenario, layout: Layout, report: Report | None = None) -> Plan:
        """Lay the tour and let UAV u fly u/U of its length ahead; takes well under a second on ``paper``."""
        loop = _loop(shortest_tour(_served(scenario, layout)))
        ahead = np.arange(scenario.uavs) * len(loop) // scenario.uavs
        return _finished(self.name, scenario, layout, [np.roll(loop, -offset, axis=0) for offset in ahead])


class PartitionTour(RoutePlanner):
    """The tour's stops cut into one run for each UAV, about as long each, and a tour through each run."""

    name: ClassVar[str] = "partition-tour"

    def plan(self, scenario: Scenario, layout: Layout, report: Report | None = None) -> Plan:
        """Cut the tour and give each part to the UAV that has its CDS nearest."""
        served = _served(scenario, layout)
        runs = _cut(shortest_tour(served), scenario.uavs)
        loops = [_loop(improve(run)) for run in runs]
        cds = Flight(scenario).cds  # (U, 2)
        way = np.array([[np.abs(loop - home).sum(axis=1).min() for loop in loops] for home in cds])  # (U, runs)
        uavs, parts = linear_sum_assignment(way)
        of_uav = dict(zip(uavs.tolist(), parts.tolist(), strict=True))
        own = [loops[of_uav[u]] if u in of_uav else cds[u : u + 1] for u in range(scenario.uavs)]
        return _finished(self.name, scenario, layout, own)


def _served(scenario: Scenario, layout: Layout) -> Bools:
    """Whether a stop in a cell serves a device, (X, Y, I): likely enough, on average over the UAVs' altitudes."""
    probability = coverage_probability(scenario, layout).mean(axis=0)  # (X, Y, I)
    best = probability.max(axis=(0, 1))  # (I,)
    served: Bools = (probability >= _LIKELY * np.minimum(1.0, best)) & (best > 0.0)
    return served


def shortest_tour(served: Bools) -> Ints:
    """The stops of a short closed tour that serves every device that can be, in order, (S, 2).

    Args:
        served: whether a stop in a cell serves a device, (X, Y, I).
    """
    stops = improve(_cover(served))
    for _ in range(4):  # sliding and ordering help each other; more rounds change nothing
        before = _length(stops)
        stops = improve(_slide(stops, served))
        if _length(stops) == before:
            break
    return stops


def _cover(served: Bools) -> Ints:
    """Stops that serve all devices, those that serve most first, (S, 2); greedy set cover."""
    left = served.any(axis=(0, 1))  # (I,)
    stops = []
    while left.any():
        column, row = np.unravel_index((served & left).sum(axis=-1).argmax(), served.shape[:2])
        stops.append((int(column), int(row)))
        left = left & ~served[column, row]
    return np.array(stops or [(0, 0)])


def _slide(stops: Ints, served: Bools) -> Ints:
    """Drop stops that serve nobody alone, and move the others to where the way is shorter."""
    kept = list(map(tuple, stops.tolist()))
    reachable = served.any(axis=(0, 1))  # (I,)
    for stop in list(kept):
        others = [cell for cell in kept if cell is not stop]
        by_others = np.any([served[cell] for cell in others], axis=0) if others else np.zeros_like(reachable)
        needed = reachable & ~by_others  # (I,)
        at = next(k for k, cell in enumerate(kept) if cell is stop)
        if not needed.any() and others:
            kept.pop(at)
            continue
        columns, rows = np.nonzero(served[..., needed].all(axis=-1))
        cells = np.stack([columns, rows], axis=1)  # (M, 2)
        neighbours = np.array([kept[at - 1], kept[(at + 1) % len(kept)]])
        way = np.abs(cells[:, None] - neighbours).sum(axis=(1, 2))  # (M,) grid steps there and on
        kept[at] = tuple(cells[way.argmin()].tolist())
    return np.array(kept)


def _length(stops: Ints) -> int:
    return int(np.abs(stops - np.roll(stops, -1, axis=0)).sum())


def improve(stops: Ints) -> Ints:
    """The stops (S, 2) in an order of a shorter closed way: nearest neighbour, 2-opt, Or-opt."""
    order = [0]
    left = set(range(1, len(stops)))
    while left:
        here = stops[order[-1]]
        order.append(min(left, key=lambda k: (int(np.abs(stops[k] - here).sum()), k)))
        left.remove(order[-1])
    best, length = stops[order], _length(stops[order])
    improved = True
    while improved:
        improved = False
        for candidate in _neighbours(best):
            shorter = _length(candidate)
            if shorter < length:
                best, length, improved = candidate, shorter, True
                break
    return best


def _neighbours(stops: Ints) -> list[Ints]:
    """All orders one 2-opt or one Or-opt move away."""
    number, found = len(stops), []
    for first in range(1, number):
        for end in range(first + 2, number + 1):
            found.append(np.concatenate([stops[:first], stops[first:end][::-1], stops[end:]]))
    for first in range(number):
        for end in range(first + 1, min(first + 3, number) + 1):
            rest, moved = np.delete(stops, np.s_[first:end], axis=0), stops[first:end]
            found += [np.concatenate([rest[:at], moved, rest[at:]]) for at in range(1, len(rest) + 1)]
    return found


def _loop(stops: Ints) -> Ints:
    """The cells of one round over the stops, (L, 2), each a grid step from the one before; L >= 1."""
    cells = [stops[0]]
    for here, there in pairwise([*stops, stops[0]]):
        cells += _way(here, there)
    return np.array(cells[:-1] if len(cells) > 1 else cells)


def _way(here: Ints, there: Ints) -> list[Ints]:
    """The cells after ``here`` up to ``there``, along x first."""
    way, cell = [], here.copy()
    for axis in (0, 1):
        while cell[axis] != there[axis]:
            cell[axis] += np.sign(there[axis] - cell[axis])
            way.append(cell.copy())
    return way


def _cut(stops: Ints, parts: int) -> list[Ints]:
    """The stops of a tour as at most ``parts`` runs of about the same length; the first stop begins a run."""
    legs = np.abs(np.diff(stops, axis=0)).sum(axis=1)  # (S-1,)
    reached = np.concatenate([[0], np.cumsum(legs)])  # (S,)
    part = np.minimum(reached * parts // max(_length(stops), 1), parts - 1)
    return [stops[part == number] for number in np.unique(part)]


def _finished(name: str, scenario: Scenario, layout: Layout, loops: list[Ints]) -> Plan:
    routes = np.stack([ride(scenario, u, loop) for u, loop in enumerate(loops)], axis=1)  # (K, U, 2)
    return Plan(name, routes, mean_aou_s(scenario, layout, routes))


def ride(scenario: Scenario, uav: int, loop: Ints) -> Ints:
    """The route of a UAV that is at ``loop[t mod L]`` in slot t from as soon to as late as its rules allow, (K, 2)."""
    flight, slots = Flight(scenario), scenario.slots
    home, budget = flight.cds[uav], int(flight.budget[uav])
    route = np.tile(home, (slots, 1))  # row t - 1 is slot t
    away = np.abs(loop - home).sum(axis=1)  # (L,) grid steps from and to the CDS
    meeting = next((t for t in range(1, slots + 1) if away[t % len(loop)] <= t - 1), None)
    if meeting is None or 2 * away[meeting % len(loop)] > budget or away[meeting % len(loop)] > slots - meeting:
        return route
    out = _way(home, loop[meeting % len(loop)])
    route[meeting - 1 - len(out) : meeting] = [home, *out]
    flown, t = len(out), meeting
    while t < slots:
        step = int(np.abs(loop[(t + 1) % len(loop)] - loop[t % len(loop)]).sum())
        back = int(away[(t + 1) % len(loop)])
        if back > slots - (t + 1) or flown + step + back > budget:
            break
        route[t], flown, t = loop[(t + 1) % len(loop)], flown + step, t + 1
    back_home = _way(route[t - 1], home)
    for cell in back_home:
        route[t], t = cell, t + 1
    return route
