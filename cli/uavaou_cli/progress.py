"""What a long job shows while it runs: a bar on a terminal, a line now and then elsewhere, or nothing."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from uavaou.planners.plan import Progress
    from uavaou.tuning.search import TrialRecord
    from uavaou.world import World

_BAR_EVERY_S = 0.5
_LINE_EVERY_S = 10.0
_NAME_WIDTH = 20


class _Progress:
    """A bar while it is entered, where there is a terminal and the user has not asked for quiet.

    Args:
        total: what the bar counts up to.
        quiet: show nothing.
    """

    figures: tuple[str, ...] = ("rate", "aou")  # columns of the bar

    def __init__(self, total: float, quiet: bool) -> None:
        self._total = total
        self._quiet = quiet
        self._bar: Any = None

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            self._bar = _make_bar(*self.figures)
            self._task = self._bar.add_task("", total=self._total, **dict.fromkeys(self.figures, ""))
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


class EvaluationProgress(_Progress):
    """Shows how far the missions of several policies are.

    Args:
        names: of the policies, in the order in which they play.
        slots: that each of them plays.
        quiet: show nothing.
    """

    def __init__(self, names: list[str], slots: int, quiet: bool) -> None:
        super().__init__(slots * len(names), quiet)
        self._names = names
        self._slots = slots
        self._name = ""
        self._before = 0  # slots of the policies that have played
        self._started = time.monotonic()
        self._next = self._started

    def start(self, name: str) -> None:
        """The next policy begins."""
        self._before = self._slots * self._names.index(name)
        self._name = name if len(name) <= _NAME_WIDTH else "..." + name[3 - _NAME_WIDTH :]
        now = time.monotonic()
        self._started, self._next = now, now + (_LINE_EVERY_S if self._bar is None else _BAR_EVERY_S)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._before, description=self._name, rate="", aou="")

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of the policy's are done; for :func:`uavaou.evaluation.evaluate.evaluate`."""
        now = time.monotonic()
        if self._quiet or now < self._next:
            return
        rate = slots / max(now - self._started, 1e-9)
        aou = f"mean AoU so far {world.metrics().mean_aou_s.mean():,.0f} s"  # costs: not in every slot
        if self._bar is not None:
            self._next = now + _BAR_EVERY_S
            self._bar.update(self._task, completed=self._before + slots, rate=f"{rate:,.0f} slots/s", aou=aou)
            return
        self._next = now + _LINE_EVERY_S
        done = self._before + slots
        left = (self._total - done) / rate
        share = done / self._total
        print(f"{share:4.0%}  {self._name}: {rate:,.0f} slots/s, {aou}, {left:,.0f} s left", file=sys.stderr)


class PlanningProgress(_Progress):
    """Shows the best routes so far, the bound on them, and the gap between the two.

    Args:
        slot_length_s: tau, in which ages are shown.
        bound_s: what is known before planning, s; None where the planner finds it itself.
        quiet: show nothing.
    """

    figures = ("figures",)

    def __init__(self, slot_length_s: float, bound_s: float | None, quiet: bool) -> None:
        super().__init__(1.0, quiet)
        self._slot_length_s = slot_length_s
        self._bound_s = bound_s
        self._next = time.monotonic() + (0.0 if sys.stderr.isatty() else _LINE_EVERY_S)

    def show(self, progress: Progress) -> None:
        """Show how far the planning is; for :meth:`uavaou.planners.plan.RoutePlanner.plan`."""
        now = time.monotonic()
        if self._quiet or (now < self._next and progress.share < 1.0):
            return
        figures = f"mean AoU {progress.incumbent_s / self._slot_length_s:,.2f} slots"
        bound_s = self._bound_s if progress.bound_s is None else progress.bound_s
        if bound_s is not None:
            gap = 1 - bound_s / progress.incumbent_s if progress.incumbent_s else 0.0
            figures += f", bound {bound_s / self._slot_length_s:,.2f}, gap {gap:.1%}"
        if self._bar is not None:
            self._next = now + _BAR_EVERY_S
            self._bar.update(self._task, completed=progress.share, figures=figures)
            return
        self._next = now + _LINE_EVERY_S
        print(f"{progress.share:4.0%}  {figures}", file=sys.stderr, flush=True)


def _make_bar(*figures: str) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        *(TextColumn(f"{{task.fields[{figure}]}}") for figure in figures),
        TimeRemainingColumn(compact=True),
        console=Console(stderr=True),
        expand=True,
        transient=True,
    )


class TuningProgress(_Progress):
    """Shows how the trials of a search stand: a bar on a terminal, a line for each that ends elsewhere.

    Args:
        trials: that are to end in all.
        quiet: show nothing.
    """

    def __init__(self, trials: int, quiet: bool) -> None:
        super().__init__(trials, quiet)
        self._told: set[int] | None = None  # trials that ended before this command are not news

    def show(self, records: list[TrialRecord]) -> None:
        """The trials as they stand."""
        if self._quiet:
            return
        ended = [record for record in records if record.counts]
        scores = [record.score for record in ended if record.score is not None]
        best = f"best mean AoU {min(scores):,.2f} s" if scores else ""
        if self._bar is not None:
            running = sum(record.state == "running" for record in records)
            rate = f"{len(ended)} of {self._total} trials, {running} running"
            self._bar.update(self._task, completed=len(ended), rate=rate, aou=best)
            return
        if self._told is None:
            self._told = {record.number for record in ended}
        for record in ended:
            if record.number not in self._told:
                self._told.add(record.number)
                score = "" if record.score is None else f" {record.score:,.2f} s,"
                detail = f": {record.reason}" if record.reason else f",{score} {best}"
                print(f"{len(self._told)}/{self._total}  trial {record.number} {record.state}{detail}", file=sys.stderr)
