"""Simulated annealing on the expected age itself, over the routes of the whole fleet slot by slot.

The objective is exact (:mod:`uavaou.planners.search`): no fading is drawn, so nothing is fitted to draws, and a
proposal costs only the slots that it changes. The routes stay flyable throughout: proposals keep the ends at the
CDS, and one that would exceed the flight-time budget is not taken.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from uavaou.planners.greedy import BestFirst
from uavaou.planners.plan import Plan, Progress, Report, RoutePlanner
from uavaou.planners.search import Expectation, anneal, expect, mean_aou_s, refresh, total_age
from uavaou.planners.tour import PartitionTour, Tour
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.flight import Flight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PROPOSALS_A_SLOT = 4000  # without a time limit; about half a minute on `paper`
_HOT, _COLD = 0.06, 0.002  # temperatures, in slots of age for each slot of the mission
_CHUNK_S = 0.25  # between looks at the clock and the keyboard
_FIRST_CHUNK = 5000  # proposals; all of them where no clock decides


class Anneal(RoutePlanner):
    """Annealed routes, started from the best of the two tours and one flight of the best-first greedy planner.

    Without a time limit the number of proposals is fixed (4000 a slot) and the plan the same on every run; with
    one, the temperature follows the clock. Ctrl-C ends the search and keeps the best routes.
    """

    name: ClassVar[str] = "anneal"

    def plan(self, scenario: Scenario, layout: Layout, report: Report | None = None) -> Plan:
        """Anneal; see :class:`RoutePlanner`."""
        begun = time.monotonic()
        starts = [tour().plan(scenario, layout).routes for tour in (Tour, PartitionTour)]
        starts.append(flown_best_first(scenario, layout))
        start = min(starts, key=lambda routes: mean_aou_s(scenario, layout, routes))
        search = Annealing(scenario, expect(scenario, layout, start), np.random.default_rng(0))
        interrupted = False
        try:
            for share in self._cool(search, begun):
                if report is not None:
                    report(Progress(share, scenario.slot_length_s * search.best_age / scenario.slots))
        except KeyboardInterrupt:
            interrupted = True
        routes = search.best_routes()
        return Plan(self.name, routes, mean_aou_s(scenario, layout, routes), interrupted=interrupted)

    def _cool(self, search: Annealing, begun: float) -> Iterator[float]:
        """Run the search in chunks; yields the share of it that is done."""
        share, done, proposals, work = 0.0, 0, _FIRST_CHUNK, PROPOSALS_A_SLOT * search.slots
        while share < 1.0:
            chunk, before = time.monotonic(), share
            if self.time_limit_s is None:
                proposals = min(proposals, work - done)
                done += proposals
                share = done / work
            else:
                share = min(1.0, (chunk - begun + _CHUNK_S) / self.time_limit_s)
            search.run(proposals, _temperature(before), _temperature(share))
            if self.time_limit_s is not None:  # without one, chunks of a fixed size: the clock must decide nothing
                proposals = max(_FIRST_CHUNK, int(proposals * min(4.0, _CHUNK_S / (time.monotonic() - chunk))))
            yield share


def flown_best_first(scenario: Scenario, layout: Layout) -> Ints:
    """The routes (K, U, 2) that the best-first greedy planner flies in one mission on this layout."""
    pinned = scenario.replace(
        layout="fixed",
        devices_m=layout.positions.tolist(),
        bandwidth_hz=layout.bandwidth.tolist(),
        transmit_power_mw=(1000 * layout.transmit_power).tolist(),
        update_period_slots=layout.update_period.tolist(),
    )
    world, planner, cells = World(pinned), BestFirst(), []
    planner.reset(world, 0)
    while not world.done:
        cells.append(world.cells[0])
        world.step(*planner.act(world))
    return np.stack(cells)


def _temperature(share: float) -> float:
    """Geometric cooling."""
    return float(_HOT * (_COLD / _HOT) ** share)


class Annealing:
    """A search under way: routes, their expectation, and the best routes met.

    Args:
        scenario: whose rules of flight hold.
        expectation: of the routes to start from; changed in place.
        rng: of the proposals.
    """

    def __init__(self, scenario: Scenario, expectation: Expectation, rng: np.random.Generator) -> None:
        self._expectation = expectation
        self._grid = (scenario.columns, scenario.rows)
        self.slots = scenario.slots
        self._rng = rng
        self._budget = Flight(scenario).budget  # (U,)
        self._flown = np.count_nonzero(np.diff(expectation.routes[:, 1:], axis=1), axis=1)  # (U,) grid steps
        self._best = expectation.routes.copy()  # (U, K+1)
        self.best_age = total_age(expectation)

    def run(self, proposals: int, hot: float, cold: float, low: int = 2, high: int | None = None) -> None:
        """Try ``proposals`` changes of slots low <= t < high, cooling from ``hot`` to ``cold`` slots of age a slot."""
        high = self.slots if high is None else high  # the cell of slot K is the CDS
        if high > low:
            temperatures = (hot * self.slots, cold * self.slots)
            self.best_age = anneal(
                self._expectation, self._grid, self._budget, self._flown, (low, high), temperatures, proposals,
                self._best, self.best_age, self._rng,
            )  # fmt: skip
            refresh(self._expectation)  # the rounding errors of many small changes end here

    def best_routes(self) -> Ints:
        """The best routes met, (K, U, 2)."""
        cells = self._best[:, 1:].T  # (K, U)
        return np.stack(np.divmod(cells, self._grid[1]), axis=-1)
