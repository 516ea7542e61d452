"""What evaluations and planners show while they run: a bar on a terminal, a line now and then elsewhere, or nothing."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from uavaou.planners.plan import Progress
    from uavaou.world import World

_BAR_EVERY_S = 0.5
_LINE_EVERY_S = 10.0
_NAME_WIDTH = 20


class EvaluationProgress:
    """Shows how far the missions of several policies are.

    Args:
        names: of the policies, in the order in which they play.
        slots: that each of them plays.
        quiet: show nothing.
    """

    def __init__(self, names: list[str], slots: int, quiet: bool) -> None:
        self._names = names
        self._slots = slots
        self._quiet = quiet
        self._bar: Any = None
        self._name = ""
        self._before = 0  # slots of the policies that have played
        self._started = time.monotonic()
        self._next = self._started

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            self._bar = _make_bar("rate", "aou")
            self._task = self._bar.add_task("", total=self._slots * len(self._names), rate="", aou="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def start(self, name: str) -> None:
        """The next policy begins."""
        self._before = self._slots * self._names.index(name)
        self._name = name if len(name) <= _NAME_WIDTH else "..." + name[3 - _NAME_WIDTH :]
        now = time.monotonic()
        self._started, self._next = now, now + (_LINE_EVERY_S if self._bar is None else _BAR_EVERY_S)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._before, description=self._name, rate="", aou="")

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of the policy's are done; for :func:`uavaou.experiments.evaluation.evaluate`."""
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
        left = (self._slots * len(self._names) - done) / rate
        share = done / (self._slots * len(self._names))
        print(f"{share:4.0%}  {self._name}: {rate:,.0f} slots/s, {aou}, {left:,.0f} s left", file=sys.stderr)


class PlanningProgress:
    """Shows the best routes so far, the bound on them, and the gap between the two.

    Args:
        slot_length_s: tau, in which ages are shown.
        bound_s: what is known before planning, s; None where the planner finds it itself.
        quiet: show nothing.
    """

    def __init__(self, slot_length_s: float, bound_s: float | None, quiet: bool) -> None:
        self._slot_length_s = slot_length_s
        self._bound_s = bound_s
        self._quiet = quiet
        self._bar: Any = None
        self._next = time.monotonic() + _LINE_EVERY_S

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            self._bar = _make_bar("figures")
            self._task = self._bar.add_task("planning", total=1.0, figures="")
            self._bar.start()
            self._next = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

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
