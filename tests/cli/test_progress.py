"""What long jobs show: plain lines where there is no terminal, a bar on one, and nothing with ``--quiet``."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaou.planners.plan import PlanningStatus
from uavaou_cli import progress
from uavaou_cli.progress import Display, EvaluationDisplay, TrainingDisplay


@pytest.fixture(autouse=True)
def always_due(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_LINE_EVERY_S", 0)
    monkeypatch.setattr(progress, "_BAR_EVERY_S", 0)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that the test sets."""
    now = SimpleNamespace(s=0.0)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now.s))
    return now


def on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    for name, value in (("COLUMNS", "80"), ("TERM", "xterm"), ("FORCE_COLOR", "1")):
        monkeypatch.setenv(name, value)


def test_a_training_that_overshoots_its_budget_ends_at_100_percent(
    capsys: pytest.CaptureFixture[str], clock: SimpleNamespace
) -> None:
    display = TrainingDisplay(slot_length_s=2.0)
    display.start(total=1000, done=0, uavs=3)
    for slots in (500, 1060):
        clock.s += 5
        display.update(slots, 24.0)
    assert capsys.readouterr().err.splitlines() == [
        " 50%  training: 100 slots/s, 300 agent steps/s, mean AoU 12.00 slots, 5.0 s left",
        "100%  training: 106 slots/s, 318 agent steps/s, mean AoU 12.00 slots, 0.0 s left",
    ]


def test_a_training_shows_the_search_for_its_plan(capsys: pytest.CaptureFixture[str], clock: SimpleNamespace) -> None:
    display = TrainingDisplay(slot_length_s=2.0)
    clock.s += 20
    display.plan(PlanningStatus(0.25, 24.0))
    display.close()
    display.start(total=1000, done=0, uavs=3)
    clock.s += 20
    display.update(500, 22.0)
    assert capsys.readouterr().err.splitlines() == [
        " 25%  plan: mean AoU 12.00 slots, 1 min 0 s left",
        " 50%  training: 25 slots/s, 75 agent steps/s, mean AoU 11.00 slots, 20.0 s left",
    ]


def test_a_bar_that_was_taken_away_comes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    on_a_terminal(monkeypatch)
    display = TrainingDisplay(slot_length_s=2.0)
    assert display._bar is None  # nor later, where the training is refused
    display.plan(PlanningStatus(0.25, 24.0))
    searching = display._bar
    assert searching is not None
    display.close()
    display.start(total=1000, done=0, uavs=3)
    assert display._bar not in (searching, None)
    assert display._bar.live.is_started
    display.close()


def test_the_rate_of_a_resumed_training_leaves_out_what_was_trained_before(
    capsys: pytest.CaptureFixture[str], clock: SimpleNamespace
) -> None:
    display = TrainingDisplay(slot_length_s=2.0)
    display.start(total=10_000_000, done=9_000_000, uavs=3)
    clock.s += 1
    display.update(9_000_100, None)
    assert "100 slots/s, 300 agent steps/s, mean AoU -, 2 h 46 min left" in capsys.readouterr().err


def test_displays_show_the_gap_to_the_bound_and_nothing_if_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    with Display(True, 10) as display:
        display.advance(5, "figure")
        display.message("news")
    assert capsys.readouterr().err == ""
    with Display(False, 1.0, "", slot_length_s=2.0) as display:
        display.bound_s = 18.0
        display.plan(SimpleNamespace(share=1.0, incumbent_s=20.0, bound_s=None))  # type: ignore[arg-type]
    assert "mean AoU 10.00 slots, bound 9.00, gap 10.0%" in capsys.readouterr().err


def test_a_bar_fits_80_columns(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    on_a_terminal(monkeypatch)
    with TrainingDisplay(slot_length_s=2.0) as display:
        display.start(total=3_000_000, done=0, uavs=3)
        display.update(1_234_567, 24.0)
        display._bar.refresh()
        display.message("a line [that stays]")
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
    assert "a line [that stays]" in shown
    assert any(
        "training" in line and " 41%" in line and "mean AoU 12.00 slots" in line and "left" in line
        for line in shown.replace("\r", "\n").splitlines()
    )
    assert all(len(line) <= 80 for line in shown.replace("\r", "\n").splitlines())


def test_the_time_left_of_missions_leaves_out_the_planning_and_other_policies(
    capsys: pytest.CaptureFixture[str], clock: SimpleNamespace
) -> None:
    world: Any = SimpleNamespace(
        metrics=lambda: SimpleNamespace(mean_aou_s=np.array([4.0])), scenario=SimpleNamespace(slot_length_s=2.0)
    )
    display = EvaluationDisplay(False, ["anneal", "greedy"], slots=1000)
    for name in ("anneal", "greedy"):
        display.start(name)
        clock.s += 28 if name == "anneal" else 0  # plans before take-off
        for slots in (100, 200):
            display.after_slot(slots, world)
            clock.s += 1
        display.after_slot(300, world)
    shown = capsys.readouterr().err.splitlines()
    assert shown[1] == " 15%  anneal: 100 slots/s, mean AoU so far 2.00 slots, 7.0 s left for this policy"
    assert shown[-1] == " 65%  greedy: 100 slots/s, mean AoU so far 2.00 slots, 7.0 s left"


def test_a_job_that_stands_still_keeps_a_time_left(capsys: pytest.CaptureFixture[str], clock: SimpleNamespace) -> None:
    display = Display(False, 4, unit="")
    for done in (1, *[1] * 100):
        clock.s += 1
        display.advance(done, "")
    assert capsys.readouterr().err.splitlines()[-1] == " 25%  5 min 3 s left"
