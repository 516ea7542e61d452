"""Tours: the fleet repeats a closed tour that passes every device at a cell where it is probably in range.

The tours solve a close-enough travelling salesman problem (CETSP) by the routing solver of OR-Tools. ``tour`` spaces
the UAVs evenly in time on one tour; its largest latency is within 2 (1 - 1/k) of the best cyclic schedule of k agents
(Afshani et al., 2022). ``partition-tour`` cuts that tour into parts and plans a tour for each UAV over the devices of
its part. A UAV dwells at a stop as long as that lowers the exact expected age of all rounds. Several thresholds of
coverage probability are tried, and the tours with the lowest expected age are taken.
"""

import math
import pickle
import subprocess
import sys
import time
from abc import abstractmethod
from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from uavaou.arrays import Bools, Ints
from uavaou.errors import InputError
from uavaou.planners.expected import ExpectedAge
from uavaou.planners.plan import OnProgress, PlanningStatus, RoutePlan, RoutePlanner, expected_age, expected_mean_aou
from uavaou.planners.search import recompute
from uavaou.scenario import Layout, Scenario
from uavaou.world.coverage import coverage_probability
from uavaou.world.flight import Flight, free_moves

_DISTANCES_A_SECOND = 5_000_000  # between stops, that reach the solver at most
_SOLVER = Path(__file__).with_name("ortools_process.py")
# P(R >= R_min) from which a cell covers a device, as a fraction of the best of any cell; each is tried.
_THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


class _Tours(RoutePlanner):
    """Plan tours with dwell times for each coverage of the devices, and take the best."""

    give_up_at = math.inf  # s of time.monotonic(): plan() then returns the best so far, or all stay

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RoutePlan:
        """Plan the tours; see :class:`RoutePlanner`. A time limit adds a longer search in the time that is left."""
        if free_moves(scenario) is not None:
            raise InputError(
                f"{self.name}: scenario '{scenario.name}' has an outline or zones, and tours do not lead around them: "
                "take another planner, such as anneal"
            )
        started = time.monotonic()
        probability = coverage_probability(scenario, layout).mean(axis=0)  # (X, Y, I)
        best = probability.max(axis=(0, 1))  # (I,)
        routes = np.tile(Flight(scenario).cds, (scenario.slots, 1, 1))  # (K, U, 2): stay if no device is in reach
        expected = expected_age(scenario, layout, routes)
        least, interrupted = expected.total_age, False
        searches = 1 if self.time_limit_s is None else 2
        try:
            coverages = [(probability >= share * best) & (best > 0.0) for share in _THRESHOLDS if best.any()]
            limits = self._limits(started) if coverages else ()
            found = (tours for limit in limits for tours in self._tours(scenario, coverages, limit))
            for done, tours in enumerate(found, start=1):
                dwelling, age = _with_dwell_times(scenario, expected, tours, self.give_up_at)
                routes, least = (dwelling, age) if age < least else (routes, least)
                if on_progress is not None:
                    share = done / (searches * len(_THRESHOLDS))
                    on_progress(PlanningStatus(share, scenario.slot_length_s * least / scenario.slots))
        except TimeoutError:
            pass
        except KeyboardInterrupt:
            interrupted = True
        return RoutePlan(self.name, expected_mean_aou(scenario, layout, routes), routes, interrupted=interrupted)

    def _limits(self, started: float) -> Iterator[float | None]:
        """The time of each search: none for the usual one, then the time left, without that of the dwell times."""
        yield None
        if self.time_limit_s is not None:
            usual = time.monotonic() - started  # the second search is followed by dwell times too
            if self.time_limit_s > 2 * usual:
                yield self.time_limit_s - 2 * usual

    @abstractmethod
    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        """Return the stops (S, 2) of each coverage (X, Y, I): one tour for the whole fleet, or one for each UAV."""


class Tour(_Tours):
    """One tour for all UAVs, which are spaced evenly in time."""

    name: ClassVar[str] = "tour"

    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        return [[cells] for cells, _ in close_enough_tours(coverages, time_limit_s, self.give_up_at)]


class PartitionTour(_Tours):
    """A tour cut into parts of about equal length, one for each UAV, and a new tour over the devices of each part."""

    name: ClassVar[str] = "partition-tour"

    def _tours(self, scenario: Scenario, coverages: list[Bools], time_limit_s: float | None) -> list[list[Ints]]:
        half = None if time_limit_s is None else time_limit_s / 2
        parts = []  # of each coverage, (X, Y, devices of the part) each
        whole = close_enough_tours(coverages, half, self.give_up_at)
        for covered, (cells, device) in zip(coverages, whole, strict=True):
            part = _cut(cells, scenario.uavs)  # (V,)
            parts.append([covered[..., device[part == own]] for own in np.unique(part)])
        tours = iter(close_enough_tours([covered for own in parts for covered in own], half, self.give_up_at))
        cds = Flight(scenario).cds  # (U, 2)
        return [_assigned([next(tours)[0] for _ in own], cds) for own in parts]


def _assigned(tours: list[Ints], cds: Ints) -> list[Ints]:
    """Assign a tour (S, 2) to each UAV, so that they are nearest to the CDSs (U, 2) in sum; a UAV without one stays."""
    distance = np.array([[np.abs(tour - home).sum(axis=1).min() for tour in tours] for home in cds])  # (U, tours)
    of_uav = dict(zip(*(found.tolist() for found in linear_sum_assignment(distance)), strict=True))
    return [tours[of_uav[u]] if u in of_uav else cds[u : u + 1] for u in range(len(cds))]


def _cut(cells: Ints, parts: int) -> Ints:
    """Return the part, from 0, of each stop of a tour (V, 2); the parts are runs of about equal length."""
    legs = np.abs(cells - np.roll(cells, -1, axis=0)).sum(axis=1)  # (V,) grid steps to the next stop
    reached = np.cumsum(legs) - legs  # (V,)
    part: Ints = reached * parts // max(int(legs.sum()), 1)
    return part


def _with_dwell_times(
    scenario: Scenario, expected: ExpectedAge, tours: list[Ints], give_up_at: float
) -> tuple[Ints, float]:
    """Lengthen the stay at one stop after another while that lowers the age; return routes (K, U, 2) and their age.

    ``tours`` are the stops (S, 2) of one tour for the whole fleet or of one for each UAV; ``expected`` is overwritten.
    """
    dwell = [np.ones(len(tour), dtype=np.int64) for tour in tours]  # slots at each stop, (S,) each
    routes = fleet_routes(scenario, tours, dwell)
    least, improved = _age(scenario, expected, routes), True
    while improved:
        if time.monotonic() > give_up_at:
            raise TimeoutError
        improved = False
        for slots, stop in [(one, stop) for one in dwell for stop in range(len(one))]:
            slots[stop] += 1
            longer = fleet_routes(scenario, tours, dwell)
            age = _age(scenario, expected, longer)
            if age < least:
                routes, least, improved = longer, age, True
            else:
                slots[stop] -= 1
    return routes, least


def _age(scenario: Scenario, expected: ExpectedAge, routes: Ints) -> float:
    """Return the total age of ``routes`` (K, U, 2), with the coverage that ``expected`` holds."""
    expected.routes[:, 1:] = (routes[..., 0] * scenario.rows + routes[..., 1]).T  # column 0 is the CDS of any route
    recompute(expected)
    return expected.total_age


def fleet_routes(scenario: Scenario, tours: list[Ints], dwell: list[Ints]) -> Ints:
    """Return routes (K, U, 2) that repeat the tours; on a common tour, UAV u is u/U of its slots ahead."""
    loops = [_loop(stops, slots) for stops, slots in zip(tours, dwell, strict=True)]
    if len(loops) == 1:
        ahead = np.arange(scenario.uavs) * len(loops[0]) // scenario.uavs
        loops = [np.roll(loops[0], -offset, axis=0) for offset in ahead]
    flight = Flight(scenario)
    return np.stack([_route(flight, scenario.slots, u, loop) for u, loop in enumerate(loops)], axis=1)


def _loop(stops: Ints, dwell: Ints) -> Ints:
    """Return the cells of one round over the stops (S, 2) with ``dwell`` (S,) slots at each, (L, 2)."""
    cells = []
    for (here, there), slots in zip(pairwise([*stops, stops[0]]), dwell, strict=True):
        cells += [np.tile(here, (slots, 1)), _path(here, there)[:-1]]
    return np.concatenate(cells)


def _path(here: Ints, there: Ints) -> Ints:
    """Return the cells after ``here`` up to ``there``, along x first, (n, 2)."""
    (along_x, along_y), direction = np.abs(there - here), np.sign(there - here)
    steps = np.repeat(np.diag(direction), [along_x, along_y], axis=0)  # (n, 2)
    path: Ints = here + np.cumsum(steps, axis=0)
    return path


def _route(flight: Flight, slots: int, uav: int, loop: Ints) -> Ints:
    """Return the route (K, 2) of a UAV that is at ``loop[t mod L]`` in slot t for as long as its rules allow."""
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
    end = meeting + int(np.append(home_in_time, False).argmin())  # the first slot away from the loop
    if end == meeting:
        return route[1:]
    route[meeting:end] = at[meeting:end]
    for path, first in ((_path(home, at[meeting])[:-1], meeting - away[meeting] + 1), (_path(at[end - 1], home), end)):
        route[first : first + len(path)] = path
    return route[1:]


def close_enough_tours(
    coverages: list[Bools], time_limit_s: float | None = None, give_up_at: float = math.inf
) -> list[tuple[Ints, Ints]]:
    """Return a short closed tour for each coverage, over cells that cover every device that any cell covers.

    A close-enough travelling salesman problem is solved as a generalised one: each cell that covers a device is a node
    of that device's group, and the tour visits one node of each group. Nodes in the same cell have distance 0.

    Args:
        coverages: whether a cell covers a device, (X, Y, I) each; at least one does.
        time_limit_s: for all tours together; None ends each at a local optimum, the same on every run.
        give_up_at: s of ``time.monotonic()`` at which the solver is stopped.

    Returns:
        The cells of each tour in order, (V, 2), and the device that each cell is visited for, (V,). A tour starts in a
        cell of the device that has the fewest; that stop also covers all other devices in its reach, which have no
        stop of their own.

    Raises:
        TimeoutError: it was stopped.
    """
    if time_limit_s is not None:
        return _solve(coverages, time_limit_s / len(coverages), give_up_at)
    return _local_optima(tuple((covered.shape, covered.tobytes()) for covered in coverages), give_up_at)


@lru_cache(maxsize=64)  # planners share tours, and a solver process takes longer to start than most tours to find
def _local_optima(coverages: tuple[tuple[tuple[int, ...], bytes], ...], give_up_at: float) -> list[tuple[Ints, Ints]]:
    arrays = [np.frombuffer(content, dtype=np.bool_).reshape(shape) for shape, content in coverages]
    return _solve(arrays, None, give_up_at)


def _solve(coverages: list[Bools], seconds: float | None, give_up_at: float) -> list[tuple[Ints, Ints]]:
    """Run the solver in its own process, for so many seconds a tour."""
    nodes = [_nodes(covered) for covered in coverages]
    left = None if math.isinf(give_up_at) else max(give_up_at - time.monotonic(), 0.0)
    if left is not None and sum(len(cells) ** 2 for cells, _ in nodes) > _DISTANCES_A_SECOND * left:
        raise TimeoutError
    problems = [(np.abs(cells[:, None] - cells).sum(axis=-1), device) for cells, device in nodes]  # (N, N) steps, (N,)
    command = [sys.executable, "-P", str(_SOLVER)]  # -P: no import from the script's own folder
    try:
        solved = subprocess.run(command, input=pickle.dumps((problems, seconds)), capture_output=True, timeout=left)
    except subprocess.TimeoutExpired:
        raise TimeoutError from None
    if solved.returncode:
        raise RuntimeError(f"OR-Tools ended with {solved.returncode}:\n{solved.stderr.decode(errors='replace')}")
    orders = pickle.loads(solved.stdout)
    return [(cells[order], device[order]) for (cells, device), order in zip(nodes, orders, strict=True)]


def _nodes(covered: Bools) -> tuple[Ints, Ints]:
    """Return the candidate cells, (N, 2), and the device of each, (N,); the tour starts at the first."""
    device, column, row = np.nonzero(np.moveaxis(covered, -1, 0))  # (M,) each
    choices = np.bincount(device, minlength=covered.shape[-1])  # (I,)
    hardest = np.where(choices > 0, choices, len(device) + 1).argmin()
    own = np.flatnonzero(device == hardest)
    start = own[covered[column[own], row[own]].sum(axis=-1).argmax()]  # the cell that covers most other devices too
    at_start = covered[column[start], row[start]]  # (I,)
    nodes = np.concatenate([[start], np.flatnonzero(~at_start[device])])  # (N,)
    return np.stack([column, row], axis=1)[nodes], device[nodes]
