"""Parts of a study that fail, are interrupted, or in progress; damaged tables."""

import gzip
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import Shell
from tests.experiments.small import TINY, Inline, Write, assert_same_tables, refusing, run_inline
from tests.synthetic_study import without
from uavaou import InputError, Scenario, read_study
from uavaou.evaluation.flights import Flights, PartKey
from uavaou.experiments.executor import StoppedEarlyError, outcome
from uavaou.experiments.jobs import Fly, Training, TrainingReport
from uavaou.experiments.run import StudyState, seconds_left, study_status
from uavaou.experiments.study import Study
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import holder, one_writer
from uavaou.runs.names import config_folder
from uavaou_cli.progress import StudyDisplay


def first_folder(study: Study, out: Path) -> RunFolder:
    return config_folder(out, next(iter(study.runs()))[1])


def of_mappo(job: Any) -> bool:
    return isinstance(job, Training) and job.config.algorithm.name == "mappo"


def test_a_failed_run_stops_no_other_and_is_tried_again(write: Write, tmp_path: Path, shell: Shell) -> None:
    study = Study.load(write(TINY))
    in_the_way = first_folder(study, tmp_path / "out")
    in_the_way.path.mkdir(parents=True)
    in_the_way.config.write_text("schema: 1\nseed: 1\n")
    executor = Inline(refusing(lambda job: not (isinstance(job, Training) and job.config.seed == 0)))
    ended = run_inline(study, tmp_path / "out", executor)
    assert ended.done == 1
    assert "the fields algorithm, scenario are missing" in ended.failed[PartKey("mappo", "tiny", 0)]
    assert ended.failed[PartKey("anneal", "tiny")] == ended.failed[PartKey("own critic", "tiny", 1)] == "no wind today"
    shown = shell.out(f"study status {tmp_path / 'mine.yaml'} --out {tmp_path / 'out'}")
    assert "7 parts, 1 finished, 6 failed" in shown
    assert "own critic on tiny, seed 1: no wind today" in shown
    in_the_way.config.unlink()
    assert run_inline(study, tmp_path / "out", Inline()).failed == {}
    assert "failed" not in {part.state for part in study_status(study, tmp_path / "out")}


def test_a_bug_in_one_run_keeps_its_traceback_and_stops_no_other(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: 1").replace("[greedy, anneal]", "[]")))
    real = Training.run
    monkeypatch.setattr(Training, "run", lambda job, tell: 1 // 0 if of_mappo(job) else real(job, tell))
    ended = run_inline(study, tmp_path / "out", Inline())
    assert ended.done == 2
    assert "ZeroDivisionError" in ended.failed[PartKey("mappo", "tiny", 0)]
    assert "Traceback" in capsys.readouterr().err


def test_an_interrupted_run_resumes_to_the_same_results(
    copied: tuple[Study, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from uavaou.runs import train as training

    study, out = copied
    real = training.train

    def broken(*arguments: Any, **options: Any) -> Any:
        def after_update(status: Any) -> None:
            if status.slots >= 96:
                raise InputError("the lights went out")

        return real(*arguments, **(options | {"after_update": after_update, "checkpoint_every_s": 0}))

    monkeypatch.setattr(training, "train", broken)
    ended = run_inline(study, tmp_path / "again", Inline())
    assert set(ended.failed.values()) == {"the lights went out"}
    monkeypatch.setattr(training, "train", real)
    executor = Inline()
    assert run_inline(study, tmp_path / "again", executor).failed == {}
    assert {type(job) for job in executor.done} == {Training}  # planners and the bound were done before
    assert_same_tables(tmp_path / "again", out)


def test_an_interrupt_in_a_compiled_function_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_: object) -> None:
        raise SystemError("CPUDispatcher(...) returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(Fly, "run", run)
    job = pickle.dumps(Fly(("anneal",), Scenario.load("tiny"), 3, 1.0))
    with pytest.raises(StoppedEarlyError):
        outcome(job, [], lambda report: None).result()


# -- in progress ---------------------------------------------------------------------------------------


def test_the_display_shows_jobs_in_progress(capsys: pytest.CaptureFixture[str]) -> None:
    running = {PartKey("greedy", "tiny"): None, PartKey("mappo", "tiny", 0): TrainingReport(10, 40.0, "process 1")}
    progress = StudyDisplay(quiet=False)
    progress._next = 0
    progress.show(StudyState(5, 3, running=running, left=100))
    assert "3/5 done; mean AoU in slots: mappo 40.00; at work: greedy for tiny" in capsys.readouterr().err


def test_jobs_of_a_killed_command_are_not_shown_as_running(copied: tuple[Study, Path]) -> None:
    study, out = copied
    without(out / "studies/mine", policy="greedy")
    (out / "studies/mine/.state.json").write_text('{"running": [["greedy", "tiny", null]], "failed": []}')
    states = {part.key.policy: part.state for part in study_status(study, out)}
    assert states["greedy"] == "waiting"
    with one_writer(out / "studies/mine"):
        states = {part.key.policy: part.state for part in study_status(study, out)}
    assert states["greedy"] == "running"
    for damaged in ("[]", '{"failed": 3}', '{"running": [[1]]}', "{"):
        (out / "studies/mine/.state.json").write_text(damaged)
        assert {part.state for part in study_status(study, out)} == {"finished", "waiting"}


def test_one_command_at_a_time_runs_a_study(copied: tuple[Study, Path], shell: Shell) -> None:
    study, out = copied
    folder = first_folder(study, out)
    without(out / "studies/mine", policy="mappo")
    for path in out.glob("tiny/mappo*/*/flights.csv.gz"):
        path.unlink()
    with one_writer(folder.path):
        assert "process" in str(holder(folder.lock))
        parts = study_status(study, out)
        assert (parts[0].state, parts[0].slots, parts[0].budget) == ("running", 192, 192)
        assert {part.state for part in parts if part.key == PartKey("mappo", "tiny", 1)} == {"trained"}
        assert seconds_left(parts) == 0
    with one_writer(out / "studies/mine"):
        code, _, err = shell(f"study run {out.parent / 'mine.yaml'} --out {out}")
    assert (code, "is being written by process" in err) == (2, True)


# -- damage --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("flights", lambda text: text.replace("policy", "pollicy"), "column 'policy' is missing"),
        ("curves", lambda text: text.replace(",tiny,0,", ",tiny,x,", 1), "column 'seed': 'x' is not a whole number"),
        ("flights", lambda text: text.replace("10000", "nan", 1), "'nan' is not a whole number"),
        ("flights", lambda text: text.splitlines()[0] + "\n" + "1," * 60 + "\n", "line 2: 60 values, expected"),
        ("flights", lambda text: text.splitlines()[0] + "\n1,2\n", "line 2: 2 values, expected"),
        ("flights", lambda text: "", "column 'policy' is missing"),
        ("flights", None, "cannot be read: it is damaged"),
    ],
)
def test_damaged_results_are_named(
    name: str, spoil: Callable[[str], str] | None, message: str, copied: tuple[Study, Path]
) -> None:
    path = copied[1] / "studies/mine" / f"{name}.csv.gz"
    if spoil is None:
        path.write_bytes(path.read_bytes()[:-20])
    else:
        path.write_bytes(gzip.compress(spoil(gzip.decompress(path.read_bytes()).decode()).encode()))
    with pytest.raises(InputError, match=name) as caught:
        read_study(path.parent)
    assert message in str(caught.value)


def test_a_missing_study_is_named(copied: tuple[Study, Path]) -> None:
    folder = copied[1] / "studies/mine"
    (folder / "study.yaml").unlink()
    with pytest.raises(InputError, match=r"holds no study\.yaml"):
        read_study(folder)
    with pytest.raises(InputError, match="does not exist"):
        read_study(folder / "nowhere")


def test_tables_are_written_to_the_same_bytes(copied: tuple[Study, Path], tmp_path: Path) -> None:
    folder = copied[1] / "studies/mine"
    Flights.read(folder).write(tmp_path / "again")
    for name in ("flights.csv.gz", "curves.csv.gz"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_numbers_have_six_digits_and_whole_ones_all(tmp_path: Path) -> None:
    values = [0.123456789, 123456789.0, -1.5e7, np.nan]
    rows = {"mean_aou_slots": 1.0, "best_slots": values, "slots": 3_000_064}
    Flights.of(rows, policy="a", scenario="b").write(tmp_path)
    found = Flights.read(tmp_path).flights
    np.testing.assert_array_equal(found["best_slots"], [0.123457, 123456789, -15000000, np.nan])
    assert set(found["slots"]) == {3_000_064}
