"""The rule of ``local-greedy`` with numbers of its own for each layout, found by flying simulated missions."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np

from uavaou.arrays import Floats, Ints
from uavaou.planners.local_greedy import LocalGreedy, LocalGreedyParts
from uavaou.planners.parts import REACHES, WEIGHTS, PartsSearch, parts_area
from uavaou.planners.plan import AheadPlanner, OnProgress, Plan, PlanningStatus
from uavaou.planners.rule import make_chart, score
from uavaou.scenario import Layout, Scenario
from uavaou.threads import Tasks, threads
from uavaou.world import World
from uavaou.world.coverage import cell_coverage
from uavaou.world.flight import neighbours
from uavaou.world.patrol import Singles
from uavaou.world.pull import SHARE, PullPlan, steps_to

PROPOSALS = 4000  # without a time limit
_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the best coverage probability, from which a cell is good enough
_PARTS = 0.4  # fraction of the search in which each device has one UAV, and parts are flown alone
_CHEAPER = 60  # slots of one UAV in such a flight, two of them side by side, that take the time of a slot of a mission
_DRAWS = ((_PARTS, 16), (0.7, 32), (1.0, 64))  # missions that score a rule, up to a fraction of the search
_HOT = 0.003  # first temperature, in mean AoU; it falls to 0
_FRESH = 1_000_000  # number of the first draw that the search has not seen
_CHANGES = ("weight", "drop", "add", "reach", "share", "swap")
_ODDS = (0.35, 0.1, 0.18, 0.15, 0.12, 0.1)  # of each change
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


class LocalGreedyTuned(AheadPlanner[RulePlan], LocalGreedy):
    """The rule of :class:`LocalGreedy` with free weights, reaches and shares for each pair of a UAV and a device.

    They are found before take-off, by the mean AoU of simulated missions on common draws of fading. The search begins
    with areas of the UAVs, which have to beat ``local-greedy`` and ``local-greedy-parts``, and goes on with the numbers
    of single pairs. In flight, each UAV remembers when each device was last in its own range. Several UAVs may serve a
    device.

    Args:
        time_limit_s: of the planning.
        slots: that are simulated, in the place of a time: the plan is then the same on every run.
    """

    name: ClassVar[str] = "local-greedy-tuned"

    def __init__(self, time_limit_s: float | None = None, slots: int | None = None) -> None:
        super().__init__(time_limit_s)
        self.slots = slots

    def plan(self, scenario: Scenario, layout: Layout, on_progress: OnProgress | None = None) -> RulePlan:
        """Tune the rule; see :class:`AheadPlanner`. The mean AoU is that of 64 draws that the search has not seen."""
        if self.time_limit_s is not None:
            load_kernels()
        started = time.monotonic()
        search, interrupted = _Search(scenario, layout), False
        try:
            for done in self._fractions(search, started):
                search.step(done)
                if on_progress is not None:
                    on_progress(PlanningStatus(done, scenario.slot_length_s * search.best_age))
        except KeyboardInterrupt:
            interrupted = True
        return search.best_plan(self.name, scenario.slot_length_s, interrupted)

    def _fractions(self, search: _Search, started: float) -> Iterator[float]:
        """Yield the fraction of the search that is done, before each proposal."""
        if self.slots is not None:
            while (done := search.slots / self.slots) < 1.0:
                yield done
        elif self.time_limit_s is None:
            yield from (proposal / PROPOSALS for proposal in range(PROPOSALS))
        else:
            while (done := (time.monotonic() - started) / self.time_limit_s) < 1.0:
                yield done

    def reset(self, world: World, seed: int) -> None:
        """Tune the rule for each layout that has no plan yet; draw nothing from ``seed``."""
        self._pull = np.stack([plan.pull for plan in self.plan_layouts(world)])  # (L, U, C, I)
        self._target = neighbours(world.scenario)[0]  # (C, 5)

    def _last(self, world: World) -> Ints:
        return np.where(world.in_range, world.slot, world.last_in_range)


@cache
def load_kernels() -> None:
    """Load what is compiled, or compile it, by a search on a small map."""
    small = Scenario.load("tiny")
    LocalGreedyTuned(slots=1).plan(small, small.draw_layout())


class _Search:
    """Annealing over the numbers of the rule. A rule is scored on the same draws as the present one, and given up early
    on part of them if it is clearly worse."""

    def __init__(self, scenario: Scenario, layout: Layout) -> None:
        self._chart, self._rng = make_chart(scenario, layout), np.random.default_rng(0)
        probability = cell_coverage(scenario, layout)  # (U, C, I)
        best = probability.max(axis=1, keepdims=True)  # (U, 1, I)
        grid = (scenario.uavs, scenario.columns, scenario.rows, scenario.devices)
        self._steps = np.stack(
            [steps_to((probability >= share * best).reshape(grid)).reshape(probability.shape) for share in _SHARES]
        ).astype(np.float32)  # (S, U, C, I)
        self._can = best[:, 0] >= _LEAST_COVERAGE  # (U, I)
        self._numbers = np.ones((3, scenario.uavs, scenario.devices))  # weight, reach, index of the share
        self._numbers[2] = _SHARES.index(SHARE)
        self._draws, self._ages = 0, np.empty(0)
        self.slots, self._mission_slots = 0, scenario.slots  # simulated so far, and those of a mission
        world, reaches = World(scenario.pinned(layout)), best[None, :, 0] > 0.0  # (1, U, I)
        fixed = [rule.owners(world, reaches)[0] for rule in (LocalGreedy(), LocalGreedyParts())]  # (I,) each
        self._start(fixed)
        own = parts_area(world), fixed[-1], self._steps, _SHARES.index(SHARE), self._can
        places = layout.positions / [scenario.area_x_m, scenario.area_y_m]  # (I, 2)
        self._parts = [PartsSearch(*own), PartsSearch(*own, places)]

    def _start(self, fixed: list[Ints]) -> None:
        """Begin with the better of the fixed rules, by the UAV that each device belongs to, (I,)."""
        starts = []
        for owners in fixed:
            self._numbers[0] = (owners == np.arange(len(self._can))[:, None]) & self._can
            self._write_pull()
            starts.append((float(self._score(_DRAWS[0][1]).mean()), self._numbers.copy()))
        _, self._best = min(starts, key=lambda start: start[0])
        self._more_draws(0.0)

    def _write_pull(self) -> None:
        weight, reach, share = self._numbers[:, :, None]  # (U, 1, I) each
        steps = np.take_along_axis(self._steps, share[None].astype(np.int64), axis=0)[0]  # (U, C, I)
        self._pull = _pull(weight, reach, steps)  # (U, C, I)

    def _column(self, uav: int, device: int) -> Floats:
        """Return the pull of a device on a UAV in each cell, (C,)."""
        weight, reach, share = self._numbers[:, uav, device]
        return _pull(weight, reach, self._steps[int(share), uav, :, device])

    def _score(self, missions: int, first_draw: int = 0) -> Floats:
        """Return the mean age of the present numbers in each mission, (missions,) slots."""
        ages = np.empty(missions)
        self.slots += missions * self._mission_slots
        own = self._chart, self._pull, self._numbers[0] > 0
        blocks = range(0, missions, -(-missions // threads()))
        Tasks(*(partial(score, *own, first_draw + at, ages[at : at + blocks.step]) for at in blocks)).run()
        return ages

    def _more_draws(self, done: float) -> None:
        """Score with as many draws as the fraction of the search asks for; go on from the best numbers with more."""
        draws = next(count for until, count in _DRAWS if done <= until)
        if draws != self._draws:
            self._numbers = self._best.copy()
            self._write_pull()
            self._draws, self._ages = draws, self._score(draws)
            self.best_age = float(self._ages.mean())

    def step(self, done: float) -> None:
        """Propose one change when a fraction ``done`` of the search is over, and accept or undo it."""
        if done < _PARTS:
            self._try_parts(done / _PARTS)
            return
        self._take_parts()
        self._more_draws(done)
        self._try_numbers(done)

    def _try_parts(self, done: float) -> None:
        """Improve the parts and their numbers, each part flown alone, from two starts side by side."""
        before = sum(search.slots for search in self._parts)
        Tasks(*(partial(search.step, done) for search in self._parts)).run()
        self.slots += (sum(search.slots for search in self._parts) - before) // _CHEAPER

    def _take_parts(self) -> None:
        """Go on from the parts found, if they are better in whole missions."""
        for search in self._parts:
            self._numbers[:] = search.numbers[:, None]
            self._numbers[0] *= (search.owners == np.arange(len(self._can))[:, None]) & self._can
            self._write_pull()
            age = float(self._score(_DRAWS[0][1]).mean())
            if age < self.best_age:
                self._best, self.best_age = self._numbers.copy(), age
        if self._parts:
            self._parts, self._draws = [], 0  # all is scored anew

    def _try_numbers(self, done: float) -> None:
        """Change the numbers of a pair or two, and accept or undo it."""
        before, changed = self._numbers.copy(), set()
        for _ in range(1 + int(self._rng.random() < 0.3)):
            changed |= self._change()
        self._refresh(changed)
        temperature = _HOT * float(self._ages.mean()) * (1.0 - done) ** 2
        ages = self._race(temperature * self._rng.exponential(), self._ages)
        if ages is None:
            self._numbers = before
            self._refresh(changed)
            return
        self._ages = ages
        if float(ages.mean()) < self.best_age:
            self._best, self.best_age = self._numbers.copy(), float(ages.mean())

    def _refresh(self, pairs: set[tuple[int, int]]) -> None:
        for uav, device in sorted(pairs):
            self._pull[uav, :, device] = self._column(uav, device)

    def _race(self, margin: float, rival: Floats) -> Floats | None:
        """Return the ages of the present numbers, (draws,); None once they are above the ``rival`` by the margin."""
        ages, first = np.empty(self._draws), 0
        for end in (max(self._draws // 8, 4), self._draws // 2, self._draws):
            ages[first:end] = self._score(end - first, first)
            worse, first = ages[:end] - rival[:end], end
            doubt = worse.std() / np.sqrt(end) if end < self._draws and np.isfinite(worse).all() else 0.0
            if worse.mean() > margin + doubt:
                return None
        return ages

    def _change(self) -> set[tuple[int, int]]:
        """Change the numbers of a pair or two at random; return these pairs of a UAV and a device."""
        rng, (weight, reach, share) = self._rng, self._numbers
        served = np.argwhere(weight > 0)
        kind = rng.choice(_CHANGES, p=_ODDS) if len(served) else "add"
        candidates = np.argwhere(self._can) if kind == "add" else served
        if not len(candidates):
            return set()
        uav, device = (int(index) for index in candidates[rng.integers(len(candidates))])
        if kind == "weight":
            weight[uav, device] = np.clip(weight[uav, device] * np.exp(0.5 * rng.normal()), *WEIGHTS)
        elif kind == "drop":
            weight[uav, device] = 0.0
        elif kind == "add":
            weight[uav, device] = np.clip(np.exp(rng.normal()), *WEIGHTS)
        elif kind == "reach":
            reach[uav, device] = np.clip(reach[uav, device] * np.exp(0.4 * rng.normal()), *REACHES)
        elif kind == "share":
            share[uav, device] = np.clip(share[uav, device] + rng.integers(-2, 3), 0, len(_SHARES) - 1)
        else:
            other = int(rng.integers(len(weight)))
            weight[:, device][[uav, other]] = weight[:, device][[other, uav]] * self._can[[uav, other], device]
            return {(uav, device), (other, device)}
        return {(uav, device)}

    def best_plan(self, name: str, slot_length_s: float, interrupted: bool) -> RulePlan:
        """Return the best numbers found."""
        self._take_parts()
        self._numbers = self._best
        self._write_pull()
        age = float(self._score(_DRAWS[-1][1], _FRESH).mean())
        weight, reach, share = self._best
        return RulePlan(
            name, slot_length_s * age, weight, reach, np.array(_SHARES)[share.astype(int)], self._pull,
            interrupted=interrupted,
        )  # fmt: skip


def _pull(weight: Floats, reach: Floats, steps: Floats | Singles) -> Floats:
    """The pull of devices at so many steps, elementwise; 0 where the weight is."""
    pull: Floats = np.where(weight > 0.0, weight * np.exp(-steps / reach), 0.0)
    return pull
