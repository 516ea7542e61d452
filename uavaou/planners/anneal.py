"""Simulated annealing of the expected age itself, over the routes of the whole fleet, slot by slot.

The objective is exact (:mod:`uavaou.planners.search`): no fading is drawn, so nothing is fitted to samples. A proposal
costs only the slots that it changes. The routes stay feasible throughout: proposals keep the first and the last cell
at the CDS, and a proposal that exceeds the flight-time budget is rejected.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from uavaou.arrays import Ints
from uavaou.planners.expected import ExpectedAge
from uavaou.planners.greedy import BestFirst
from uavaou.planners.plain import plain_model
from uavaou.planners.plan import OnProgress, PlanningStatus, RoutePlan, RoutePlanner, expected_age, expected_mean_aou
from uavaou.planners.search import NO_STATIONS, anneal, recompute
from uavaou.planners.tour import PartitionTour, Tour
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.flight import Flight, free_moves, ways

PROPOSALS_A_SLOT = 4000  # without a time limit; about half a minute on `paper`
_HOT, _COLD = 0.06, 0.002  # first and last temperature, in slots of age for each slot of the mission
_CHUNK_S = 0.25  # between two looks at the clock and the keyboard
_TOURS_SHARE = 0.25  # of the time limit, after which no other tour is begun
_TOURS_END = 0.5  # of the time limit, after which a tour is given up
_FIRST_CHUNK = 5000  # proposals; without a time limit, of every chunk


class Anneal(RoutePlanner):
    """Annealed routes, started from the best of both tours and one flight of ``best-first``.

    With zones there are no tours.

    Without a time limit, the number of proposals is fixed (4000 a slot), so the plan is the same on every run. With a
    time limit, the temperature follows the clock. Ctrl-C ends the search and keeps the best routes.
    """

    name: ClassVar[str] = "anneal"

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RoutePlan:
        """Anneal; see :class:`RoutePlanner`."""
        started, starts = time.monotonic(), []
        for tour in (Tour(), PartitionTour()) if free_moves(scenario) is None else ():
            tour.give_up_at = started + _TOURS_END * self.most_s
            if time.monotonic() - started < _TOURS_SHARE * self.most_s:
                starts.append(tour.plan(scenario, layout).routes)
        starts.append(best_first_routes(scenario, layout))
        start = min(starts, key=lambda routes: expected_mean_aou(scenario, layout, routes))
        expected, interrupted = expected_age(scenario, layout, start), False
        best = expected.routes.copy()  # (U, K+1)
        try:
            for done, age in self._cool(scenario, expected, best, started):
                if on_progress is not None:
                    on_progress(PlanningStatus(done, scenario.slot_length_s * age / scenario.slots))
        except KeyboardInterrupt:
            interrupted = True
        routes = np.stack(np.divmod(best[:, 1:].T, scenario.rows), axis=-1)  # (K, U, 2)
        return RoutePlan(self.name, expected_mean_aou(scenario, layout, routes), routes, interrupted=interrupted)

    def _cool(
        self, scenario: Scenario, expected: ExpectedAge, best: Ints, started: float
    ) -> Iterator[tuple[float, float]]:
        """Search in chunks, and write the best routes met; yield the fraction that is done, and the least total age."""
        slots, rng, budget = scenario.slots, np.random.default_rng(0), Flight(scenario).budget  # (U,)
        flown, age = flown_steps(best), expected.total_age  # (U,)
        fraction, done, proposals, work = 0.0, 0, _FIRST_CHUNK, PROPOSALS_A_SLOT * slots
        if time.monotonic() - started >= self.most_s:
            return  # even one chunk may have to be compiled
        while fraction < 1.0:
            chunk_started, hot = time.monotonic(), _temperature(fraction)
            if self.time_limit_s is None:
                proposals = min(proposals, work - done)
                done += proposals
                fraction = done / work
            else:
                fraction = min(1.0, (chunk_started - started + _CHUNK_S) / self.time_limit_s)
            if slots > 2:  # the cells of slots 1 and K are the CDS
                age = anneal(
                    expected,
                    (scenario.columns, scenario.rows, ways(scenario)),
                    budget,
                    flown,
                    (2, slots),
                    (hot * slots, _temperature(fraction) * slots),
                    proposals,
                    best,
                    age,
                    rng,
                    NO_STATIONS,
                )
                recompute(expected)  # removes the rounding errors of many small changes
            if self.time_limit_s is not None:  # without one, the clock must not affect the plan
                elapsed = time.monotonic() - chunk_started
                proposals = max(_FIRST_CHUNK, int(proposals * min(4.0, _CHUNK_S / elapsed)))
            yield fraction, age


def best_first_routes(scenario: Scenario, layout: Layout) -> Ints:
    """Return the routes (K, U, 2) that the best-first greedy planner flies in one mission on this layout."""
    world, planner, cells = World(plain_model(scenario).pinned(layout)), BestFirst(), []
    planner.reset(world, 0)
    while not world.done:
        cells.append(world.cells[0])
        world.step(*planner.act(world))
    return np.stack(cells)


def flown_steps(routes: Ints) -> Ints:
    """Return the grid steps of each route, (U,), for cells by slot (U, K+1); column 0 is not a slot."""
    steps: Ints = np.count_nonzero(np.diff(routes[:, 1:], axis=1), axis=1)
    return steps


def _temperature(fraction: float) -> float:
    """Return the temperature of geometric cooling after a fraction of the work."""
    return float(_HOT * (_COLD / _HOT) ** fraction)
