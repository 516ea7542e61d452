"""What ``uavaou study run`` shows: one bar over all runs on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from uavaou.studies.jobs import PLAN
from uavaou_cli.tables import duration

if TYPE_CHECKING:
    from uavaou.studies.runner import Standing

_LINE_EVERY_S = 10.0
_MOST_VARIANTS = 6


class StudyProgress:
    """Shows how many runs are done, the rate of all together, the time left, and how each running variant does.

    Args:
        quiet: show nothing.
    """

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._bar: Any = None
        self._next = time.monotonic() + _LINE_EVERY_S

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            columns = (TextColumn("{task.description}"), BarColumn(bar_width=None), TextColumn("{task.fields[rate]}"))
            self._bar = Progress(*columns, console=Console(stderr=True), expand=True, transient=True)
            self._task = self._bar.add_task("study", total=None, rate="")
            self._variants = self._bar.add_task("", total=1, rate="")
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, standing: Standing) -> None:
        """The study as it stands."""
        news, standing.news = standing.news, []
        if self._quiet:
            return
        for line in news:
            self._say(f"{standing.done}/{standing.total}  {line}")
        if self._bar is not None:
            done, all_of_it = _share(standing)
            self._bar.update(self._task, description=_counts(standing), completed=done, total=all_of_it,
                             rate=_rate(standing))  # fmt: skip
            self._bar.update(self._variants, description=_running(standing), completed=done / max(all_of_it, 1))
        elif time.monotonic() >= self._next and standing.running:
            self._next = time.monotonic() + _LINE_EVERY_S
            counts = ", ".join(part for part in (_counts(standing), _rate(standing)) if part)
            self._say(f"{counts}; {_running(standing)}")

    def _say(self, text: str) -> None:
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)


def _counts(standing: Standing) -> str:
    failed = f", {len(standing.failed)} failed" if standing.failed else ""
    return f"{standing.done}/{standing.total} done{failed}"


def _share(standing: Standing) -> tuple[int, int]:
    """Slots trained of all slots; parts done of all where no training is left."""
    slots = standing.slots + standing.left
    return (standing.slots, slots) if slots else (standing.done, standing.total)


def _rate(standing: Standing) -> str:
    if not standing.left:
        return ""  # planners and bounds do not say how far they are
    if not standing.slots:
        return "no rate yet"
    left_s = standing.left / standing.rate
    return f"{standing.rate:,.0f} slots/s, {duration(left_s)} left"


def _running(standing: Standing) -> str:
    """The mean AoU of the variants that train, in slots, and what else is at work."""
    means: dict[str, list[float]] = {}
    others = []
    for key, report in standing.running.items():
        if key.seed is None:
            others.append(f"{'annealing a plan' if key.variant == PLAN else key.variant} for {key.scenario}")
        elif report is not None and report.mean_aou_s is not None:
            means.setdefault(key.variant, []).append(report.mean_aou_s / standing.tau_s[key.scenario])
        else:
            means.setdefault(key.variant, [])
    parts = [f"{name} {sum(values) / len(values):,.2f}" if values else f"{name} -" for name, values in means.items()]
    means_shown, others_shown = parts[:_MOST_VARIANTS], others[:_MOST_VARIANTS]
    learning = ["mean AoU in slots: " + ", ".join(means_shown)] if parts else []
    return "; ".join([*learning, *(["at work: " + ", ".join(others_shown)] if others else [])])
