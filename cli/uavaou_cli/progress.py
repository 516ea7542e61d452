"""The progress of long jobs: a bar on a terminal, a line every ten seconds elsewhere, nothing with ``--quiet``."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Self

import typer

from uavaou.errors import command_line
from uavaou.runs.interrupt import exit_code
from uavaou_cli.tables import duration

if TYPE_CHECKING:
    from uavaou.evaluation.recorded_mission import RecordedMission
    from uavaou.experiments.run import StudyState
    from uavaou.experiments.search import Trial
    from uavaou.planners.plan import PlanningStatus
    from uavaou.scenario import Scenario
    from uavaou.world import World

_BAR_EVERY_S = 0.5
_LINE_EVERY_S = 10.0
_RATE_AFTER_S = 60.0  # of a study; before, processes start and compile
_MARKS = 60  # steps forward that the rate is measured over
_WIDE = 110  # columns of a terminal that has room for agent steps
NAME_WIDTH = 20
_MOST_VARIANTS = 6


class Display:
    """Shows the progress of a job on stderr: its rate, the time left, and the figure that matters.

    Args:
        quiet: show nothing.
        total: of the work.
        unit: of the rate; empty where there is none to show.
        slot_length_s: tau; ages come in seconds and are shown in slots.
    """

    bound_s: float | None = None  # on the AoU of a plan; None where there is none, or the planner finds it itself

    def __init__(self, quiet: bool, total: float, unit: str = "slots", slot_length_s: float = 1.0) -> None:
        self.quiet = quiet
        self.total = total
        self._unit = unit
        self._tau_s = slot_length_s
        self._bar: Any = None
        self.measure_from(0)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Start the bar where there is a terminal."""
        if not self.quiet and sys.stderr.isatty() and self._bar is None:
            self._bar = _start_bar()
            self.measure_from(0)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def message(self, text: str) -> None:
        """Show a line that stays."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        elif not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def measure_from(self, done: float, name: str = "", text: str = "") -> None:
        """Measure the rate from now on: ``done`` of the total is done, and the part ``name`` begins with ``text``."""
        now = time.monotonic()
        self._marks = deque([(now, done)], maxlen=_MARKS)
        self._next = now + (_LINE_EVERY_S if self._bar is None else _BAR_EVERY_S)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._share(done), description=name, text=text)

    def _share(self, done: float) -> float:
        return min(done / self.total, 1.0) if self.total else 1.0

    def _speed(self, rate: float) -> str:
        return f"{rate:,.0f} {self._unit}/s" if self._unit else ""

    def _left(self, done: float, rate: float) -> str:
        return f"{duration(max(self.total - done, 0) / rate)} left"

    @property
    def due(self) -> bool:
        """Whether it is time to show something again."""
        return not self.quiet and time.monotonic() >= self._next

    def advance(self, done: float, figure: str, name: str = "", note: str = "", rate: float | None = None) -> None:
        """Show that ``done`` of the total is done.

        Args:
            done: of the total.
            figure: the one that matters, with its unit.
            name: of the part in progress.
            note: a second line, below the bar.
            rate: units a second; None: as measured from what was shown, 0: unknown.
        """
        now = time.monotonic()
        if rate is None:
            since, before = self._marks[0]
            rate = (done - before) / max(now - since, 1e-9)
        if done > self._marks[-1][1]:  # a job that stands still for long keeps its rate, which falls slowly
            self._marks.append((now, done))
        parts = [self._speed(rate) if rate > 0 else "", figure]
        if rate > 0:
            parts.append(self._left(done, rate))
        share, text = self._share(done), ", ".join(filter(None, parts))
        if self._bar is not None:
            self._next = now + _BAR_EVERY_S
            self._bar.note = note
            self._bar.update(self._bar.task_ids[0], completed=share, description=name, text=text)
        elif not self.quiet:
            self._next = now + _LINE_EVERY_S
            words = "; ".join(filter(None, (": ".join(filter(None, (name, text))), note)))
            print(f"{share:4.0%}  {words}", file=sys.stderr, flush=True)

    def plan(self, status: PlanningStatus, name: str = "routes") -> None:
        """Show the best plan so far, and the gap to the bound; for :meth:`uavaou.planners.plan.AheadPlanner.plan`."""
        if not self.due and status.share < 1.0:
            return
        shown = f"mean AoU {status.incumbent_s / self._tau_s:,.2f} slots"
        bound_s = self.bound_s if status.bound_s is None else status.bound_s
        if bound_s is not None:
            gap = 1 - bound_s / status.incumbent_s if status.incumbent_s else 0.0
            shown += f", bound {bound_s / self._tau_s:,.2f}, gap {gap:.1%}"
        self.advance(status.share, shown, name)


def _start_bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.text import Text

    class Bar(Progress):
        note = ""

        def get_renderables(self) -> Any:
            yield self.make_tasks_table(self.tasks)
            if self.note:
                yield Text(self.note, no_wrap=True, overflow="ellipsis")

    texts = "{task.description}", "{task.percentage:3.0f}%", "{task.fields[text]}"
    name, share, text = (TextColumn(column, markup=False) for column in texts)
    columns = name, BarColumn(bar_width=None), share, text
    bar = Bar(*columns, console=Console(stderr=True), expand=True, transient=True)
    bar.add_task("", total=1.0, text="")
    bar.start()
    return bar


class TrainingDisplay(Display):
    """Shows a training, :class:`uavaou.runs.recorder.Display`: its rate, and the mean AoU of recent missions."""

    def __init__(self, slot_length_s: float) -> None:
        super().__init__(quiet=False, total=0, slot_length_s=slot_length_s)
        self._uavs = 0.0

    def plan(self, status: PlanningStatus, name: str = "plan") -> None:
        """Show where the search for the plan stands that the training begins with."""
        self.total = 1.0
        self.open()
        super().plan(status, name)

    def start(self, total: int, done: int, uavs: float) -> None:
        """Begin at ``done`` of ``total`` slots, with ``uavs`` agent steps a slot."""
        self.total, self._uavs = total, uavs
        self.open()
        self.measure_from(done, "training")

    def update(self, slots: int, mean_aou_s: float | None) -> None:
        """``slots`` are done; the mean AoU of recent missions is ``mean_aou_s``, None before the first."""
        if self.due:
            aou = "-" if mean_aou_s is None else f"{mean_aou_s / self._tau_s:,.2f} slots"
            self.advance(slots, f"mean AoU {aou}", "training")

    def _speed(self, rate: float) -> str:
        if not self._uavs:
            return ""
        wide = self._bar is None or self._bar.console.width >= _WIDE
        return super()._speed(rate) + (f", {rate * self._uavs:,.0f} agent steps/s" if wide else "")


class EvaluationDisplay(Display):
    """Shows the missions of policies, ``slots`` of each: the slots played, and the mean AoU of the present policy.

    The time left is that of the present policy, because others may be a thousand times slower. It does not count the
    planning before take-off, which is over when the first slot has been played.
    """

    def __init__(self, quiet: bool, names: list[str], slots: int) -> None:
        super().__init__(quiet, slots * len(names))
        self._names, self._slots = names, slots  # in the order in which they play
        self._name, self._before = "", 0  # slots of the policies that have played
        self._took_off = False

    def start(self, name: str) -> None:
        """The next policy begins."""
        self._before = self._slots * self._names.index(name)
        self._name = name if len(name) <= NAME_WIDTH else "..." + name[3 - NAME_WIDTH :]
        self._took_off = False
        self.measure_from(self._before, self._name, "before take-off")

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of the policy's are done; for :func:`uavaou.evaluation.evaluate.evaluate`."""
        if not self._took_off:
            self._took_off = True
            self.measure_from(self._before + slots, self._name)
        elif self.due:  # the mean costs: not in every slot
            mean = world.metrics().mean_aou_s.mean() / world.scenario.slot_length_s
            self.advance(self._before + slots, f"mean AoU so far {mean:,.2f} slots", self._name)

    def _left(self, done: float, rate: float) -> str:
        left = f"{duration(max(self._before + self._slots - done, 0) / rate)} left"
        return left if self._before + self._slots >= self.total else f"{left} for this policy"


class RecordingDisplay(EvaluationDisplay):
    """Also records the one mission that each policy plays."""

    def __init__(self, quiet: bool, names: list[str], slots: int) -> None:
        super().__init__(quiet, names, slots)
        self._snapshots: dict[str, list[dict[str, Any]]] = {}

    def start(self, name: str) -> None:
        """The next policy begins."""
        super().start(name)
        self._shots = self._snapshots.setdefault(name, [])

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of the policy's are done."""
        super().after_slot(slots, world)
        self._shots.append(world.snapshot())

    def missions(self, scenario: Scenario, seed: int) -> dict[str, RecordedMission]:
        """What each policy did in the mission of that seed, by the name that the command gives the policy."""
        from uavaou.evaluation.recorded_mission import RecordedMission, Recording
        from uavaou.runs.comparison import recorded_as

        recordings = {name: Recording.from_snapshots(shots) for name, shots in self._snapshots.items()}
        return {
            name: RecordedMission(scenario, *recorded_as(name), seed, recording)
            for name, recording in recordings.items()
        }


class TuningDisplay(Display):
    """Shows the trials of a search: a bar on a terminal, a line for each finished trial elsewhere."""

    def __init__(self, quiet: bool, trials: int) -> None:
        super().__init__(quiet, trials, "")
        self._told: set[int] | None = None  # trials that ended before this command are not news

    def show(self, trials: list[Trial]) -> None:
        """The trials as they stand."""
        ended, best = [trial for trial in trials if trial.counts], ""
        if self._told is None:
            self._told = {trial.number for trial in ended}
            self.measure_from(len(ended))
        news = [trial for trial in ended if trial.number not in self._told]
        for trial in news or ended[-1:]:
            self._told.add(trial.number)
            same = [one.score for one in ended if (one.arm, one.stage) == (trial.arm, trial.stage) and one.score]
            best = f"best mean AoU of {trial.arm} {min(same):,.2f} slots" if same else ""
            if news and self._bar is None:
                score = "" if trial.score is None else f" {trial.score:,.2f} slots,"
                detail = f": {trial.reason}" if trial.reason else f",{score} {best}"
                self.message(f"{len(self._told)}/{self.total:.0f}  trial {trial.number} {trial.state}{detail}")
        if self._bar is not None:
            running = len(trials) - len(ended)
            self.advance(len(ended), best, f"{len(ended)}/{self.total:.0f} trials, {running} running")


class StudyDisplay(Display):
    """Shows a study: the parts done, the rate of all trainings together, and the mean AoU of each running variant."""

    def __init__(self, quiet: bool) -> None:
        super().__init__(quiet, 1.0)

    def show(self, state: StudyState) -> None:
        """The study as it stands."""
        news, state.news = state.news, []
        for line in news:
            self.message(f"{state.done}/{state.total}  {line}")
        if not self.due or (self._bar is None and not state.running):
            return
        failed = f", {len(state.failed)} failed" if state.failed else ""
        name = f"{state.done}/{state.total} done{failed}"
        trained = state.slots + state.left  # 0 where planners and bounds are left, whose progress is unknown
        self.total = trained or state.total
        rate = state.rate if state.left and state.busy_s > _RATE_AFTER_S else 0.0
        self.advance(state.slots if trained else state.done, "", name, _running(state), rate)


def _running(state: StudyState) -> str:
    """The mean AoU of each variant in training, in slots, and the planners and bounds in progress."""
    means: dict[str, list[float]] = {}
    others = []
    for key, report in state.running.items():
        if key.seed is None:
            others.append(f"{key.policy} for {key.scenario}")
        else:
            values = means.setdefault(key.policy, [])
            if report is not None and report.mean_aou_slots is not None:
                values.append(report.mean_aou_slots)
    parts = [f"{name} {sum(values) / len(values):,.2f}" if values else f"{name} -" for name, values in means.items()]
    lists = {"mean AoU in slots": parts, "at work": others}
    return "; ".join(f"{title}: {', '.join(found[:_MOST_VARIANTS])}" for title, found in lists.items() if found)


def stopped(arguments: list[str], by: BaseException | int, kept: str = "") -> typer.Exit:
    """Tell the user, after an interrupt, which command goes on, and what it has ``kept``; the exit is to be raised.

    Args:
        arguments: of the command.
        by: the interrupt, or the number of the signal.
        kept: words that follow on "interrupted".
    """
    print(f"uavaou: interrupted{kept}; to go on: {command_line(['uavaou', *arguments])}", file=sys.stderr)
    return typer.Exit(128 + by if isinstance(by, int) else exit_code(by))
