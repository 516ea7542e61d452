"""A study as it runs: the order, what is skipped, resumed, refused and failed, and its status."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.studies.tiny_study import TINY, Inline, Write, rewritten, run_inline, tables
from uavaou import InputError
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import holder, one_writer
from uavaou.studies.condense import update_results
from uavaou.studies.folder import PartKey
from uavaou.studies.jobs import Ended, Job, Planning, Training
from uavaou.studies.results import read_study
from uavaou.studies.runner import StudyState, run_study
from uavaou.studies.status import seconds_left, study_status
from uavaou.studies.study import Study
from uavaou_cli.main import main
from uavaou_cli.progress import StudyDisplay


def test_planners_come_after_the_first_seed_and_before_the_others(finished: tuple[Path, Inline]) -> None:
    assert finished[1].keys == [
        ("mappo", "tiny", 0), ("own critic", "tiny", 0), ("bound", "tiny", None), ("greedy", "tiny", None),
        ("plan", "tiny", None), ("anneal", "tiny", None), ("mappo", "tiny", 1), ("own critic", "tiny", 1),
    ]  # fmt: skip


def test_a_finished_study_does_nothing_and_changes_nothing(copied: tuple[Study, Path]) -> None:
    study, out = copied
    before = tables(out)
    engine = Inline()
    ended = run_inline(study, out, engine)
    assert (ended.done, ended.total, ended.failed, ended.stopped_by) == (7, 7, {}, None)
    assert engine.done == []
    assert tables(out) == before


def test_a_study_resumes_from_its_condensed_results_alone(copied: tuple[Study, Path], finished: Any) -> None:
    study, out = copied
    shutil.rmtree(out / "tiny")
    shutil.rmtree(out / "planners")
    before = tables(out)
    more = Study.load(rewritten(finished[0] / "mine.yaml", out.parent / "mine.yaml", "seeds: 2", "seeds: [0, 1, 5]"))
    engine = Inline()
    assert run_inline(more, out, engine).done == 9
    assert engine.keys == [("mappo", "tiny", 5), ("own critic", "tiny", 5)]
    after = tables(out)
    for name in ("missions.csv", "runs.csv", "curves.csv"):
        assert set(before[name].splitlines()) < set(after[name].splitlines())
    assert list(study.scenarios) == ["tiny"]


def test_a_finished_study_says_that_nothing_was_trained_and_how_to_train_again(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    file = out.parent / "mine.yaml"
    assert main(["study", "run", str(file), "--out", str(out), "--quiet"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    again = f"uavaou study run {file} --out {out}-again"
    assert f"nothing was trained: all 7 parts have results already. All of them again: {again} next:" in said
    assert said.endswith(f"next: uavaou study report {file} --out {out}")
    (out / "studies" / "mine" / "bounds.csv").unlink()  # now one part is done
    assert main(["study", "run", str(file), "--out", str(out), "--quiet"]) == 0
    assert "nothing was trained" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("slots: 192", "slots: 240", "mappo on tiny with other settings"),
        ("episodes: 3", "episodes: 4", "episodes = 3, not 4"),
        ("seeds: 2", "seeds: 1", "seed 1, which the study lacks"),
        ("[greedy, anneal]", "[anneal]", "greedy on tiny, which the study lacks"),
        ("[tiny]", "[{scenario: tiny, name: tiny, set: {layout_seed: 5}}]", "tiny"),
        ("planning_seconds: 0.2", "planning_seconds: 900", "planners with planning_seconds = 0.2, not 900"),
        ("planning_seconds: 0.2", "planning_seconds: 0.25", "planners with planning_seconds = 0.2, not 0.25"),
    ],
)
def test_results_of_another_study_are_refused_and_kept(
    old: str, new: str, message: str, copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    path = rewritten(out.parent / "mine.yaml", out.parent / "mine.yaml", old, new)
    before = tables(out)
    for command in ("run", "report", "status"):
        assert main(["study", command, str(path), "--out", str(out)]) == 2
        assert message in capsys.readouterr().err
    assert tables(out) == before


def test_planning_seconds_may_change_before_anything_is_planned(write: Write, tmp_path: Path) -> None:
    small = TINY.replace("seeds: 2", "seeds: 1").replace("[greedy, anneal]", "[greedy]")
    assert run_inline(Study.load(write(small)), tmp_path / "out", Inline()).done == 4
    longer = Study.load(write(small.replace("planning_seconds: 0.2", "planning_seconds: 0.75")))
    engine = Inline()
    assert run_inline(longer, tmp_path / "out", engine).done == 4
    assert engine.done == []


@pytest.mark.parametrize("change", ["another action", "in mid-training", "of before they said what they are of"])
def test_an_evaluation_of_another_policy_or_action_is_ignored(change: str, copied: tuple[Study, Path]) -> None:
    """What ``uavaou eval`` wrote in the middle of the training, or with ``--action``, has as many missions."""
    study, out = copied
    before = tables(out)
    shutil.rmtree(out / "studies")
    first = study.folder(out, next(iter(study.runs())))
    path = first.path / "eval/default.json"
    content = json.loads(path.read_text())
    (entry,) = content["policies"].values()
    if change == "another action":
        other = {"greedy": "sample", "sample": "greedy"}[entry["action"]]
        assert main(["eval", str(first.path), "--episodes", "3", "--action", other, "--quiet"]) == 0
    else:
        digest = {"policy_sha256": "0" * 64} if change == "in mid-training" else {}
        entry.pop("policy_sha256")
        entry |= digest | {"mean_aou_s": [1.0, 2.0, 3.0]}
        path.write_text(json.dumps(content))
    results, _ = update_results(study, out)
    assert PartKey("mappo", "tiny", 0) not in results.parts
    engine = Inline()
    assert run_inline(study, out, engine).failed == {}
    assert PartKey("mappo", "tiny", 0) in engine.keys
    assert PartKey("mappo", "tiny", 1) not in engine.keys
    after = tables(out)
    for name in ("missions.csv", "execution.csv", "devices.csv", "runs.csv"):
        assert after[name] == before[name]


def test_an_evaluation_by_the_eval_command_counts(copied: tuple[Study, Path]) -> None:
    study, out = copied
    before = tables(out)
    shutil.rmtree(out / "studies")
    for run_ in study.runs():
        path = study.folder(out, run_).path
        shutil.rmtree(path / "eval")
        assert main(["eval", str(path), "--episodes", "3", "--quiet"]) == 0
    engine = Inline()
    run_inline(study, out, engine)
    assert not any(isinstance(job, Training) for job in engine.done)
    assert tables(out)["runs.csv"] == before["runs.csv"]


def test_a_report_names_a_damaged_best_checkpoint_and_goes_on(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    damaged = next(run for run in study.runs() if run.key.variant == "mappo" and f"seed-{run.key.seed}" == kept.name)
    best = study.folder(out, damaged).best
    best.write_bytes(best.read_bytes()[:-4] + b"ouch")
    before = tables(out)
    assert main(["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"left out: mappo on tiny, seed {damaged.key.seed}: {best}: damaged" in said
    after = tables(out)
    assert {name: after[name] for name in before} == before


def test_a_full_disk_fails_one_run_alone(write: Write, tmp_path: Path) -> None:
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: 1")))
    (tmp_path / "out/studies/mine/failures.csv.partial").mkdir(parents=True)  # nothing can be written in its place
    (tmp_path / "out/planners").write_text("in the way")
    said: list[str] = []
    engine = Inline(answer=lambda job: Ended(job.key, None, "no wind today") if job.key.variant == "mappo" else None)
    ended = run_study(study, tmp_path / "out", engine, lambda state: said.extend(state.news), quiet=True)
    assert ended.done == 3
    assert ended.failed[PartKey("mappo", "tiny", 0)] == "no wind today"
    plan = tmp_path / "out/planners/plans/tiny.json"
    assert f"no plan: cannot write '{plan}'" in ended.failed[PartKey("anneal", "tiny")]
    assert any("failures.csv" in line for line in said)


@pytest.mark.parametrize("command", ["run", "report"])
def test_results_that_cannot_be_written_are_refused_in_one_line(
    command: str, copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    shutil.rmtree(out / "studies/mine")
    (out / "studies/mine").mkdir()
    (out / "studies/mine/configs").write_text("in the way")
    assert main(["study", command, str(out.parent / "mine.yaml"), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"cannot write '{out / 'studies/mine/configs'}" in said


def test_status_and_display_show_jobs_in_progress(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Planners and plans have no folder whose lock would show it."""
    path = write(TINY.replace("seeds: 2", "seeds: 1"))
    out = tmp_path / "out"
    study = Study.load(path)
    states: dict[str, dict[str, str]] = {}
    lines: dict[str, str] = {}

    def answer(job: Job) -> Ended | None:
        parts = study_status(study, out)
        states[job.key.variant] = {part.key.variant: f"{part.state} {part.detail}".strip() for part in parts}
        assert main(["study", "status", str(path), "--out", str(out)]) == 0
        progress = StudyDisplay(quiet=False)
        progress._next = 0
        progress.show(states_seen[-1])
        lines[job.key.variant] = capsys.readouterr().err
        return None

    states_seen: list[StudyState] = []
    run_study(study, out, Inline(answer=answer), states_seen.append, quiet=True)
    assert states["greedy"]["greedy"] == "running"
    assert states["greedy"]["anneal"] == "waiting"
    assert states["bound"]["bound"] == "running"
    assert states["plan"]["anneal"] == "running its plan is being annealed"
    assert states["anneal"]["anneal"] == "running"
    assert "3/5 done; at work: greedy for tiny" in lines["greedy"]
    assert "4/5 done" in lines["plan"]
    assert "at work: annealing a plan for tiny" in lines["plan"]
    assert not (out / "studies/mine/.working.csv").exists()


def test_jobs_of_a_killed_command_are_not_shown_as_running(copied: tuple[Study, Path]) -> None:
    study, out = copied
    missions = out / "studies/mine/missions.csv"
    missions.write_text("".join(line for line in missions.open() if not line.startswith("greedy")))
    (out / "studies/mine/.working.csv").write_text("variant,scenario\ngreedy,tiny\n")
    states = {part.key.variant: part.state for part in study_status(study, out)}
    assert states["greedy"] == "waiting"
    run_inline(study, out, Inline())
    assert not (out / "studies/mine/.working.csv").exists()


def test_a_failed_run_stops_no_other_and_is_tried_again(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.load(write(TINY))
    in_the_way = RunFolder(study.folder(tmp_path / "out", next(iter(study.runs()))).path)
    in_the_way.path.mkdir(parents=True)
    in_the_way.config.write_text("schema: 1\nseed: 1\n")
    engine = Inline(answer=lambda job: None if job.key.seed == 0 else Ended(job.key, None, "no wind today"))
    ended = run_inline(study, tmp_path / "out", engine)
    assert ended.done == 1
    assert "the fields algorithm, scenario are missing" in ended.failed[PartKey("mappo", "tiny", 0)]
    assert ended.failed[PartKey("anneal", "tiny")] == "no plan: no wind today"
    assert ended.failed[PartKey("own critic", "tiny", 1)] == "no wind today"
    assert main(["study", "status", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "7 parts, 1 finished, 6 failed" in shown
    assert "own critic on tiny, seed 1: no wind today" in shown
    in_the_way.config.unlink()
    assert run_inline(study, tmp_path / "out", Inline()).failed == {}
    assert not (tmp_path / "out/studies/mine/failures.csv").exists()


def test_a_bug_in_one_run_keeps_its_traceback_and_stops_no_other(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: 1").replace("[greedy, anneal]", "[]")))
    real = Training.perform
    monkeypatch.setattr(
        Training, "perform", lambda job, tell: 1 // 0 if job.key.variant == "mappo" else real(job, tell)
    )
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
    engine = Inline()
    assert run_inline(study, tmp_path / "again", engine).failed == {}
    assert {type(job) for job in engine.done} == {Training}  # planners and the bound were done before
    for name in ("missions.csv", "execution.csv", "devices.csv", "bounds.csv"):
        resumed, untouched = (
            [row for row in tables(place)[name].splitlines() if not row.startswith(b"anneal")]  # as good as 0.2 s allow
            for place in (tmp_path / "again", out)
        )
        assert resumed == untouched
    ours, theirs = (read_study(place / "studies/mine").table("curves") for place in (tmp_path / "again", out))
    for column in set(ours) - {"wall_s"}:
        np.testing.assert_array_equal(ours[column], theirs[column])


def test_a_saved_plan_is_used_unless_it_was_planned_for_less_time(copied: tuple[Study, Path]) -> None:
    study, out = copied
    plan = next((out / "planners/plans").glob("tiny.json"))
    stated = json.loads(plan.read_text())
    assert stated["planning_seconds"] == 0.2
    for name in ("missions", "execution"):  # as if anneal had not been evaluated
        path = out / f"studies/mine/{name}.csv"
        path.write_text("".join(line for line in path.open() if not line.startswith("anneal")))
    shutil.copytree(out, out.parent / "less")
    engine = Inline()
    run_inline(study, out, engine)
    assert engine.keys == [("anneal", "tiny", None)]
    less = out.parent / "less"
    (less / "planners/plans/tiny.json").write_text(json.dumps(stated | {"planning_seconds": 0.1}))
    engine = Inline()
    run_inline(study, less, engine)
    assert type(engine.done[0]) is Planning
    assert json.loads((less / "planners/plans/tiny.json").read_text())["planning_seconds"] == 0.2


def test_one_command_at_a_time_runs_a_study(copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]) -> None:
    study, out = copied
    run_folder = study.folder(out, next(iter(study.runs())))
    (out / "studies/mine/runs.csv").unlink()
    with one_writer(run_folder.path):
        assert "process" in str(holder(run_folder.lock))
        (first, *others) = study_status(study, out)
        assert (first.state, first.slots, first.budget) == ("running", 192, 192)
        assert first.rate is not None
        assert {part.state for part in others[:3]} == {"trained"}
        assert seconds_left([first, *others]) == 0
    assert holder(run_folder.lock) is None
    with one_writer(out / "studies/mine"):
        assert main(["study", "run", str(out.parent / "mine.yaml"), "--out", str(out)]) == 2
    assert "is being written by process" in capsys.readouterr().err
