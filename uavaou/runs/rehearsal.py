"""Rehearsal before take-off: policies fly simulated missions of a scenario in a given time, and the best is served.

All fly the same missions, and none of them is one that results are measured on. Policies that need no time come first;
then those that plan before take-off have a share of the time each; then, where there is enough of it, a training that
begins with the best numbers found, and ``rolling``, which improves the annealed routes in flight. What is left goes to
more missions of those that may still be the best.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.evaluation.evaluate import Evaluation, play
from uavaou.evaluation.seeds import REHEARSAL_SEEDS
from uavaou.planners import make_planner
from uavaou.planners.anneal import Anneal
from uavaou.planners.base import Planner
from uavaou.planners.plain import ignored
from uavaou.planners.plan import RoutePlan
from uavaou.planners.rolling import Rolling
from uavaou.planners.tuned import LocalGreedyTuned, load_kernels
from uavaou.runs.comparison import known_by, make_policy
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.released import released_names
from uavaou.scenario import Scenario
from uavaou.statistics import Interval, interval_over_missions
from uavaou.world import World
from uavaou.world.knowledge import Knowledge, check_within, knowledge, within

if TYPE_CHECKING:
    from uavaou.runs.recorder import TrainingStatus

AT_ONCE = ("local-greedy-parts", "best-first")  # planners that need no time before take-off
_AHEAD = {"local-greedy-tuned": 0.35, "anneal": 0.15}  # shares of the time
_ROLLING = 0.3  # share of the time that `rolling` may take for its first missions
_TRAINS_FROM_S, _TRAINING = 30.0, 0.4  # with so much time there is a training, which has this share of it
_RATE = 150_000.0  # devices that a learner's UAVs look at in a second, at least
_TORCH_S, _FLIGHT_RATE = 3.0, 600_000.0  # to import torch; devices that a learner's UAVs look at in a second, in flight
_GREEDY_RATE = 500e6  # devices that the UAVs of `best-first` look at in a second, each from each cell for each choice
_CHECKS = 4  # of the policy in training
_FIRST, _MOST = 4, 128  # missions that each flies at first, and at most
_WORK = 8_000_000  # slots x UAVs x devices of a candidate's first missions, of which at least one is flown
_SOON, _HOPELESS = 0.1, 2.0  # after this share of its time, one that would need so many times as much is given up
_QUICK, _QUICK_S = 0.25, 0.6  # share of the time that one of them may take, and the least for each, s


class _Late(Exception):  # noqa: N818 - the way out of a flight
    """The time is over."""


@dataclass
class Candidate:
    """A policy in a rehearsal."""

    name: str
    policy: Planner
    run: RunFolder | None = None  # that was trained for it
    flights: list[Evaluation] = field(default_factory=list)

    @property
    def ages(self) -> Floats:
        """The mean AoU of each mission, (missions,) slots."""
        return np.concatenate([flight.values("mean_aou_s") / flight.slot_length_s for flight in self.flights])

    @property
    def ages_over_time(self) -> Floats:
        """The AoU in each slot of each mission, (missions, K) slots."""
        return np.concatenate([flight.aou_over_time_s / flight.slot_length_s for flight in self.flights])

    @property
    def mean(self) -> Interval:
        """The mean AoU with its 95 % interval, slots."""
        return interval_over_missions(self.ages)

    @property
    def knows(self) -> Knowledge:
        """What it reads in flight."""
        return knowledge(self.policy)


@dataclass(frozen=True)
class Rehearsal:
    """What a rehearsal has found."""

    scenario: Scenario
    candidates: tuple[Candidate, ...]  # the best first
    late: tuple[str, ...]  # those whose first missions took too long

    @property
    def served(self) -> Candidate:
        """The candidate with the lowest mean AoU."""
        return self.candidates[0]

    @property
    def is_clear(self) -> bool:
        """Whether the lead over the next one is more than luck: its 95 % interval over common missions is above 0."""
        return len(self.candidates) == 1 or _is_behind(self.candidates[1], self.served)

    @property
    def open_loop(self) -> dict[str, Planner]:
        """Those whose routes were planned to be flown without hearing anything, by name."""
        return {one.name: one.policy for one in self.candidates if one.knows == "nothing"}

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a JSON file."""
        run = self.served.run
        return {
            "scenario": self.scenario.name,
            "served": self.served.name,
            "served_run": None if run is None else str(run.path),
            "clear": self.is_clear,
            "candidates": [_described(candidate) for candidate in self.candidates],
            "late": list(self.late),
        }


OnRehearsal = Callable[[float, str, float | None], None]  # (share of the time, at work, best mean AoU in slots)


def rehearse(
    scenario: Scenario | Path | str,
    seconds: float = 10.0,
    knows: str = "everything",
    folder: Path | None = None,
    on_progress: OnRehearsal | None = None,
) -> Rehearsal:
    """Let policies fly simulated missions of a scenario, and find the best of them.

    Args:
        scenario: what is flown, or the name of a preset or the path of a YAML file.
        seconds: that it may take, beside a moment to load what is compiled. The first flights of a large map may take
            longer.
        knows: the most that a policy may read in flight: ``local``, ``shared`` or ``everything``.
        folder: of the training that there is from 30 seconds on, and holds no other one; None: there is none.
        on_progress: called now and then.

    Raises:
        InputError: there is no such scenario or limit, or a file cannot be written.

    Examples:
        >>> from uavaou import rehearse
        >>> rehearse("tiny", seconds=1, knows="local").served.knows in ("local", "nothing")
        True
    """
    rehearsal = _Rehearsal(Scenario.load(scenario), seconds, knows, on_progress)
    return rehearsal.result(folder)


class _Rehearsal:
    """A rehearsal in progress."""

    def __init__(self, scenario: Scenario, seconds: float, knows: str, on_progress: OnRehearsal | None) -> None:
        check_within("", "nothing", knows)
        _load_kernels()
        self.scenario, self.seconds, self.knows = scenario, seconds, knows
        self._on_progress = on_progress
        self._began = time.monotonic()
        self._candidates: list[Candidate] = []
        self._late: list[str] = []
        self._annealed: RoutePlan | None = None
        self._work = scenario.slots * scenario.uavs * scenario.devices  # of a mission
        self._quick_s = max(_QUICK * seconds, _QUICK_S)
        self._missions = int(np.clip(_WORK // self._work, 1, _FIRST))

    def result(self, folder: Path | None) -> Rehearsal:
        fixed = self.scenario.layout == "fixed"
        for name in sorted(AT_ONCE, key=lambda name: bool(ignored(make_planner(name), self.scenario))):
            self._enter_by_name(name)  # one that lives with all that the missions hold comes first, at any time
        for name, share in _AHEAD.items() if fixed else ():
            self._plan_ahead(name, share)
        self._roll()
        for name in released_names():  # last: to import torch takes longer than most missions
            self._enter_by_name(name)
        if folder is not None and fixed and self.seconds >= _TRAINS_FROM_S:
            self._train(folder)
        self._fly_the_best()
        finalists = self._finalists()
        ordered = sorted(self._candidates, key=lambda one: (one not in finalists, float(one.ages.mean())))
        return Rehearsal(self.scenario, tuple(ordered), tuple(self._late))

    def _enter_by_name(self, name: str) -> None:
        """Let a policy fly that is given no time before take-off, if it may."""
        limit_s = min(self._quick_s, self._left_s) if self._candidates else float("inf")
        if not within(known_by(name, self.knows), self.knows):
            return
        if limit_s <= 0 or self._least_s(name) > max(self._left_s, 0.0):
            self._late.append(name)
            return
        self._enter(Candidate(name, make_policy(name, self.scenario, knows=self.knows)), limit_s)

    def _enter(self, candidate: Candidate, limit_s: float) -> None:
        """Let a candidate fly its first missions."""
        try:
            candidate.flights.append(self._fly(candidate, self._missions, 0, limit_s))
            self._candidates.append(candidate)
        except _Late:
            self._late.append(candidate.name)

    def _fly(self, candidate: Candidate, missions: int, first: int, limit_s: float) -> Evaluation:
        """Fly rehearsal missions from number ``first`` on.

        Raises:
            _Late: they take more than ``limit_s``.
        """
        began, all_slots = time.monotonic(), missions * self.scenario.slots
        start: list[float] = []  # when the first slot was over: it may hold a plan, or what a library does once

        def watch(slots: int, world: World) -> None:
            now = time.monotonic()
            start[:] = start or [now]
            taken = now - began
            ahead = (now - start[0]) / max(slots - missions, 1) * (all_slots - slots)
            if taken > limit_s or (taken > _SOON * limit_s and taken + ahead > _HOPELESS * limit_s):
                raise _Late
            self._tell(candidate.name)

        return play(candidate.policy, self.scenario, missions, REHEARSAL_SEEDS.start + first, watch)

    def _tell(self, at_work: str) -> None:
        if self._on_progress is not None:
            share = (time.monotonic() - self._began) / self.seconds
            best = min((float(candidate.ages.mean()) for candidate in self._candidates), default=None)
            self._on_progress(min(share, 1.0), at_work, best)

    @property
    def _left_s(self) -> float:
        return self._began + self.seconds - time.monotonic()

    def _plan_ahead(self, name: str, share: float) -> None:
        """Let a planner plan for its share of the time, and fly."""
        limit_s = min(share * self.seconds, self._left_s)
        with suppress(InputError):  # it needs to know more, or cannot plan for such a scenario
            planner: Any = make_planner(name, limit_s, self.knows)
            if limit_s <= 0 or self._least_s(name) > max(self._left_s, 0.0):
                self._late.append(name)
                return
            layout = self.scenario.draw_layout()
            plan = planner.plan(self.scenario, layout, lambda status: self._tell(name))
            if plan.interrupted:
                raise KeyboardInterrupt
            planner.keep(plan, self.scenario, layout)
            if isinstance(planner, Anneal):
                self._annealed = plan
            self._enter(Candidate(name, planner), max(self._left_s, self._quick_s))

    def _roll(self) -> None:
        """Let the annealed routes be improved in flight, if that may be known and fits into the time that is left."""
        if self._annealed is None or self.knows != "everything":
            return
        if self._left_s <= 0:
            self._late.append(Rolling.name)
            return
        rolling = Rolling()
        rolling.keep(self._annealed, self.scenario, self.scenario.draw_layout())
        self._enter(Candidate(rolling.name, rolling), min(self._left_s, _ROLLING * self.seconds))

    def _least_s(self, name: str) -> float:
        """About how long a candidate takes whatever its limit, s; 0 for one that can be given up at any time."""
        if name in released_names():
            return _TORCH_S + self._missions * self._work / _FLIGHT_RATE
        if name == "anneal":  # it begins with a flight of `best-first`
            return self._work * self.scenario.uavs * self.scenario.columns * self.scenario.rows / _GREEDY_RATE
        return 0.0

    def _train(self, folder: Path) -> None:
        """Train a policy that begins with the numbers of ``local-greedy-tuned``, and let it fly."""
        from uavaou.runs.train import train

        tuned = next((one.policy for one in self._candidates if isinstance(one.policy, LocalGreedyTuned)), None)
        until = time.monotonic() + min(_TRAINING * self.seconds, 0.8 * self._left_s)
        rate = _RATE / (self.scenario.uavs * self.scenario.devices)  # slots/s
        slots = max(int(rate * (until - time.monotonic())), 1000)
        checks = {"evaluate_every_slots": -(-slots // _CHECKS), "evaluation_missions": 4 * _FIRST}
        config = RunConfig.load("mappo", self.scenario, slots=slots, **checks)
        run = RunFolder(folder)
        plan = None
        if tuned is not None:
            plan = tuned.plan_layouts(World(self.scenario))[0].of_map(self.scenario, self.scenario.draw_layout())

        def watch(status: TrainingStatus) -> None:
            self._tell("training")
            if time.monotonic() > until:
                raise _Late

        with suppress(_Late):
            if train(config, run, after_update=watch, plan=plan).stopped_by is not None:
                raise KeyboardInterrupt
        policy = make_policy(run, self.scenario, knows=self.knows)
        self._enter(Candidate(str(run), policy, run), max(self._left_s, self._quick_s))

    def _finalists(self) -> list[Candidate]:
        """Those that have flown most missions."""
        most = max(len(candidate.ages) for candidate in self._candidates)
        return [candidate for candidate in self._candidates if len(candidate.ages) == most]

    def _fly_the_best(self) -> None:
        """Let those that may be the best fly ever more missions, until the lead is clear or the time is over."""
        while self._left_s > 0:
            finalists = self._finalists()
            best = min(finalists, key=lambda one: float(one.ages.mean()))
            flown = len(best.ages)
            rivals = [one for one in finalists if one is not best and not _is_behind(one, best)]
            if not rivals or flown >= _MOST:
                return
            more = min(flown, _MOST - flown)
            try:
                flights = [(one, self._fly(one, more, flown, self._left_s)) for one in (best, *rivals)]
            except _Late:
                return
            for candidate, flight in flights:  # all of them, so that they have flown the same missions
                candidate.flights.append(flight)


def _load_kernels() -> None:
    """Load what is compiled, or compile it, by a rehearsal of a small map: that takes none of the time given."""
    small = Scenario.load("tiny")
    for name in AT_ONCE:
        play(make_planner(name), small, 1, REHEARSAL_SEEDS.start, None)
    load_kernels()


def _is_behind(candidate: Candidate, best: Candidate) -> bool:
    """Whether a candidate is clearly worse on common missions."""
    common = min(len(candidate.ages), len(best.ages))
    behind = candidate.ages[:common] - best.ages[:common]
    return len(behind) > 1 and interval_over_missions(behind).low > 0


def _described(candidate: Candidate) -> dict[str, Any]:
    mean = candidate.mean
    known = {"policy": candidate.name, "knows": candidate.knows, "missions": len(candidate.ages)}
    low, high = (None if np.isnan(end) else end for end in (mean.low, mean.high))
    return known | {"mean_aou_slots": mean.value, "interval": [low, high]}
