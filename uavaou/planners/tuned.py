"""The rule of ``local-greedy`` with numbers of its own for each layout, found by flying simulated missions."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.chain import Chain, numbers_of
from uavaou.planners.local_greedy import LocalGreedy, LocalGreedyParts
from uavaou.planners.plan import AheadPlanner, OnProgress, Plan, PlanningStatus
from uavaou.scenario import Layout, Scenario
from uavaou.threads import Tasks
from uavaou.world import World
from uavaou.world.flight import targets
from uavaou.world.patrol import fresh, patrol_area
from uavaou.world.pull import SHARE, PullPlan, steps_left

PROPOSALS = 4000  # without a time limit
_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the best coverage probability, from which a cell is good enough
_FLIGHTS = 24  # slots that one UAV flies, of which the search counts one
_LARGEST = 8_000_000  # draws of all missions together, for which there are fewer on a large map
_AREAS = 0.2  # fraction of the search in which one of two chains looks for areas of the UAVs
_DRAWS = ((0.4, 16), (0.7, 64), (1.0, 256))  # missions that score a rule, up to a fraction of the search
_LEAST_COVERAGE = 0.02  # best probability below which a UAV does not serve a device


@dataclass(frozen=True)
class RulePlan(Plan):
    """The numbers of a rule: UAV u is drawn to device i by weight A_ui exp(-d_ui / reach)."""

    weight: Floats  # (U, I), 0 for a device that the UAV does not serve
    reach: Floats  # (U, I) grid steps
    share: Floats  # (U, I) of the best coverage probability, from which a cell counts as arrived
    pull: Floats  # (U, C, I) weight exp(-d / reach) in each cell

    def of_map(self, scenario: Scenario, layout: Layout) -> PullPlan:
        """Return the numbers with the map that they are of."""
        return PullPlan(self.weight, self.reach, self.share, scenario.cds_cells, layout.positions)

    def to_dict(self, scenario: Scenario) -> dict[str, Any]:
        """Return plain values for a JSON file, with the scenario; the pull follows from the others."""
        numbers = {name: getattr(self, name).tolist() for name in ("weight", "reach", "share")}
        return super().to_dict(scenario) | numbers


class LocalGreedyTuned(AheadPlanner[RulePlan], LocalGreedyParts):
    """The rule of ``local-greedy`` with numbers of its own for each UAV and device, found before take-off.

    They are weights, reaches and shares, found by the mean AoU of simulated missions on common draws of fading. The
    search begins with the numbers of ``local-greedy-parts``, and side by side with those of ``local-greedy`` and with
    areas of the UAVs, and changes the numbers of single pairs. In flight, each UAV remembers when each device was last
    in its own range. Several UAVs may serve a device. One that knows of a loss goes on by the rule of
    ``local-greedy-parts``.

    Args:
        time_limit_s: of the planning.
        slots: that are simulated, in the place of a time, of which 24 that one UAV flies count as one: the plan is then
            the same on every run.
    """

    name: ClassVar[str] = "local-greedy-tuned"
    lives_with: ClassVar[tuple[str, ...]] = LocalGreedyParts.lives_with

    def __init__(self, time_limit_s: float | None = None, slots: int | None = None) -> None:
        super().__init__(time_limit_s)
        self.slots = slots

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RulePlan:
        """Tune the rule; see :class:`AheadPlanner`. The mean AoU is that of draws that the search has not seen."""
        if self.time_limit_s is not None:
            load_kernels()
        started = time.monotonic()
        search, interrupted = _Search(scenario, layout), False
        try:
            while (done := self._done(search, started)) < 1.0:
                search.step(done)
                if on_progress is not None:
                    on_progress(PlanningStatus(done, scenario.slot_length_s * search.best_age))
        except KeyboardInterrupt:
            interrupted = True
        return search.best_plan(self.name, scenario.slot_length_s, interrupted)

    def _done(self, search: _Search, started: float) -> float:
        """Return the fraction of the search that is done."""
        if self.slots is not None:
            return search.slots / self.slots
        if self.time_limit_s is None:
            return search.proposals / PROPOSALS
        return (time.monotonic() - started) / self.time_limit_s

    def reset(self, world: World, seed: int) -> None:
        """Tune the rule for each layout that has no plan yet; draw nothing from ``seed``."""
        if world.scenario.links is not None:
            super().reset(world, seed)  # who hears of a loss goes on by the parts of the survivors
        self._pull = np.stack([plan.pull for plan in self.plan_layouts(world)])  # (L, U, C, I)
        self._target = targets(world.scenario)  # (T, C, 5)

    def _last(self, world: World) -> Ints:
        return np.where(world.collecting, world.slot, world.last_in_range)


@cache
def load_kernels() -> None:
    """Load what is compiled, or compile it, by a search on a small map."""
    small = Scenario.load("tiny")
    LocalGreedyTuned(slots=1).plan(small, small.draw_layout())


class _Search:
    """Chains of changes to the numbers of the rule, side by side, that score them on the same draws."""

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        world, positions = World(scenario.pinned(layout)), layout.positions / scenario.grid_step_m  # (I, 2) grid steps
        headroom = (world.channel.mean_snr_above() / world.channel.snr_min[:, None, :])[0]  # (U, I)
        missions = min(_DRAWS[-1][1], max(_LARGEST // (scenario.slots * scenario.devices), _DRAWS[0][1]))
        missions = max(missions, scenario.uavs)
        self._area = patrol_area(scenario, world.flight.cds, positions, headroom, layout.update_period, missions)
        self._steps = np.concatenate([steps_left(world, share) for share in _SHARES])  # (S, U, C, I)
        best = self._area.probability[..., : scenario.devices].max(axis=1)  # (U, I)
        can = best >= _LEAST_COVERAGE
        everybody = np.ones(scenario.uavs, dtype=np.bool_)
        rules = LocalGreedyParts(), LocalGreedy()
        fixed = [rule.owners(world, best[None] > 0.0, everybody)[0] for rule in rules]  # (I,) each
        starts = [numbers_of(owner, can, _SHARES.index(SHARE)) for owner in fixed]
        self._chains = [Chain(self._area, self._steps, can, start, seed) for seed, start in enumerate(starts)]
        self._places = layout.positions / [scenario.area_x_m, scenario.area_y_m]  # (I, 2)
        self._draws = 0
        self._go_on(0.0)

    @property
    def slots(self) -> int:
        """How many slots the search has simulated, of :attr:`LocalGreedyTuned.slots`."""
        return sum(chain.flown for chain in self._chains) // _FLIGHTS

    @property
    def proposals(self) -> int:
        """How many changes the search has tried."""
        return sum(chain.changes for chain in self._chains)

    @property
    def best_age(self) -> float:
        """The least mean AoU, slots."""
        return min(chain.best_age for chain in self._chains)

    def _best(self) -> Floats:
        """Return the numbers with the least mean AoU, (3, U, I)."""
        return min(self._chains, key=lambda chain: chain.best_age).best

    def _go_on(self, done: float) -> None:
        """Score with as many draws as the fraction of the search asks for; with more, go on from the best numbers."""
        draws = min(next(count for until, count in _DRAWS if done <= until), len(self._area.draws))
        if draws != self._draws:
            alone = draws == _DRAWS[0][1]  # each from its own
            starts = [chain.best if alone else self._best() for chain in self._chains]
            self._draws, pairs = draws, zip(self._chains, starts, strict=True)
            Tasks(*(partial(chain.begin, start, draws) for chain, start in pairs)).run()

    def step(self, done: float) -> None:
        """Try some changes when a fraction ``done`` of the search is over."""
        self._go_on(done)
        steps = [partial(chain.step, done) for chain in self._chains]
        if done < _AREAS and len(self._area.start) > 1:
            steps[-1] = partial(self._chains[-1].try_areas, done / _AREAS, self._places, _SHARES.index(SHARE))
        Tasks(*steps).run()

    def best_plan(self, name: str, slot_length_s: float, interrupted: bool) -> RulePlan:
        """Return the best numbers found."""
        weight, reach, share = numbers = self._best()
        age = self._chains[0].score(numbers, len(self._area.draws), fresh(self._area))
        steps = np.take_along_axis(self._steps, share[None, :, None].astype(np.int64), axis=0)[0]  # (U, C, I)
        return RulePlan(
            name,
            slot_length_s * age,
            weight,
            reach,
            np.array(_SHARES)[share.astype(int)],
            pull_in_cells(weight, reach, steps),
            interrupted=interrupted,
        )


def pull_in_cells(weight: Floats, reach: Floats, steps: Floats) -> Floats:
    """Return weight exp(-steps / reach) in each cell, (U, C, I), of weights and reaches (U, I)."""
    with np.errstate(divide="ignore"):
        pull: Floats = np.exp(np.log(weight)[:, None] - steps / reach[:, None])
    return pull
