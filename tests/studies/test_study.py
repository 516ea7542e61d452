"""Studies: what their files may say, what is skipped, resumed and reported, and what the condensed results hold."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from uavaou import InputError, Scenario
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import holder, one_writer
from uavaou.studies import jobs
from uavaou.studies.condense import number
from uavaou.studies.engine import Advanced, Ended, Events, Take
from uavaou.studies.finished import report_study
from uavaou.studies.jobs import Job, Key, Planning, Report, Training, reference_keys
from uavaou.studies.processes import outcome
from uavaou.studies.results import COLUMNS, NO_SEED, read_study, rows_of
from uavaou.studies.runner import Standing, StudyOutcome, run_study
from uavaou.studies.status import seconds_left, study_status
from uavaou.studies.store import StudyStore, study_folder
from uavaou.studies.study import Study
from uavaou.zoo import zoo_names
from uavaou_cli.main import main
from uavaou_cli.progress import StudyDisplay

SET = "missions: 4, rollout_slots: 12, batch_rows: 48, hidden: [8], evaluation_missions: 2, evaluate_every_slots: 96"
TINY = f"""
description: Two small trainings
slots: 192
seeds: 2
scenarios: [tiny]
variants:
  mappo: {{set: {{{SET}}}}}
  own critic: {{algorithm: ippo, set: {{{SET}}}}}
planners: [greedy, anneal]
bound: true
planning_seconds: 0.5
episodes: 3
"""

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str, name: str = "mine.yaml") -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


# -- the file ------------------------------------------------------------------------------------------

BASE: dict[str, Any] = {"seeds": 2, "scenarios": ["tiny"], "variants": {"mappo": {}}}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"seed": 3}, "unknown field 'seed'; did you mean 'seeds'?"),
    ({"seed": 3, "seeds": ...}, "unknown field 'seed'; did you mean 'seeds'?"),  # rather than that seeds is missing
    ({"seeds": None}, "seeds = None"),
    ({"seeds": 0}, "seeds = 0"),
    ({"seeds": True}, "seeds = True"),
    ({"seeds": [0, -1]}, "not -1"),
    ({"seeds": [0, 1, 0]}, "seed 0 stands there twice"),
    ({"seeds": [2**32]}, "4294967295"),
    ({"slots": 0}, "slots = 0"),
    ({"slots": None}, "leave it out"),
    ({"slots": "3e6"}, "expected a number, not text"),
    ({"scenarios": []}, "scenarios"),
    ({"scenarios": "tiny"}, "scenarios = 'tiny': expected a list, such as [paper, tiny]"),
    ({"scenarios": {"tiny": {}}}, "scenarios = {'tiny': {}}: expected a list"),
    ({"scenarios": [{"scenario": "tiny", "slots": 20}]}, "changes of the scenario go below set"),
    ({"scenarios": [{"scenario": "tiny", "set": ["slots"]}]}, "set = ['slots']: expected a mapping, such as {uavs: 3"),
    ({"scenarios": ["tiyn"]}, "scenarios[0]: unknown scenario 'tiyn'; did you mean 'tiny'?"),
    ({"scenarios": [3]}, "scenarios[0] = 3: expected a mapping"),
    ({"scenarios": ["nowhere.yaml"]}, "does not exist"),
    ({"scenarios": ["tiny", "tiny"]}, "scenarios[1]: a second 'tiny'"),
    ({"scenarios": [{"scenario": "tiny", "sett": {}}]}, "unknown field 'sett'; did you mean 'set'?"),
    ({"scenarios": [{"scenario": "tiny", "set": {"slotz": 3}}]}, "did you mean 'slots'?"),
    ({"scenarios": [{"scenario": "tiny", "set": {"slots": 1}}]}, "slots = 1"),
    ({"scenarios": [{"scenario": "tiny", "set": {"name": "x"}}]}, "write name beside set"),
    ({"scenarios": [{"scenario": "tiny", "name": "a/b"}]}, "no slash"),
    ({"scenarios": ["tiny", {"scenario": "tiny", "name": "too"}]}, "'too' and 'tiny' are the same training"),
    ({"variants": {}}, "variants"),
    ({"variants": ["a", "b"]}, "variants = ['a', 'b']: expected a mapping, such as {mappo: {}, "),
    ({"variants": {"mappo": {"observation": "shared"}}}, "unknown field 'observation' (known: algorithm, set"),
    ({"variants": {"mappo": {"observation": "shared"}}}, "; settings of the algorithm go below set"),
    ({"variants": {"mappo": {"set": 3}}}, "set = 3: expected a mapping, such as {gamma: 0.9}"),
    ({"variants": {"mappo": {"algorithm": 3}}}, "algorithm = 3: expected text"),
    ({"variants": {"mapo": {}}}, "unknown algorithm 'mapo'; did you mean 'mappo'?"),
    ({"variants": {"x": {"algorithm": "qmixx"}}}, "did you mean 'qmix'?"),
    ({"variants": {"x": {"algoritm": "qmix"}}}, "did you mean 'algorithm'?"),
    ({"variants": {"x": 3}}, "variants.'x' = 3"),
    ({"variants": {"mappo": {"set": {"gama": 0.9}}}}, "did you mean 'gamma'?"),
    ({"variants": {"mappo": {"set": {"gamma": 2}}}}, "gamma = 2"),
    ({"variants": {"mappo": {"set": {"name": "ippo"}}}}, "choose the algorithm with algorithm"),
    ({"slots": 5, "variants": {"mappo": {"set": {"slots": 6}}}}, "give one of them"),
    ({"variants": {"mappo": {}, "again": {"algorithm": "mappo"}}}, "'mappo' and 'again' are the same training"),
    ({"variants": {"greedy": {"algorithm": "mappo"}}}, "a planner or the bound has that name"),
    ({"variants": {"../up": {"algorithm": "mappo"}}}, "no slash"),
    ({"planners": ["greddy"]}, "planners: unknown planner 'greddy'; did you mean 'greedy'? (known: random, "),
    ({"planners": "greedy"}, "planners = 'greedy': expected a list, such as [greedy, random]"),
    ({"planners": [3]}, "planners[0] = 3: expected text"),
    ({"planners": ["greedy", "greedy"]}, "a second 'greedy'"),
    ({"planners": ["tour"], "scenarios": [{"scenario": "tiny", "set": {"layout": "resample"}}]}, "new layout"),
    ({"bound": True, "scenarios": [{"scenario": "tiny", "set": {"layout": "resample"}}]}, "new layout"),
    ({"bound": "yes"}, "bound = 'yes': expected true or false"),
    ({"episodes": 0}, "episodes = 0"),
    ({"planning_seconds": -1}, "planning_seconds = -1"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=range(len(BAD)))
def test_a_study_that_cannot_be_run_is_refused_in_one_line(
    changes: dict[str, Any], message: str, write: Write, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    content = {name: value for name, value in (BASE | changes).items() if value is not ...}
    path = write(yaml.safe_dump(content))
    for command in ("run", "status", "report"):
        assert main(["study", command, str(path), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert message in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("study run papr", "did you mean 'paper'?"),
        ("study rum", "did you mean 'run'?"),
        ("study run smoke --jobs 0", "--jobs 0"),
        ("study run smoke --jobs two", "--jobs = 'two': expected a whole number"),
        ("study run smoke --checkpoint-every soon", "--checkpoint-every = 'soon': expected a number"),
        ("study run smoke --engine locl", "did you mean 'local'?"),
        ("study run smoke --address auto", "--engine ray"),
        ("study run smoke --out file", "not a folder"),
        ("study run nowhere.yaml", "nowhere.yaml"),
        ("train --config nowhere.yaml", "nowhere.yaml"),
        ("train --config x.yaml --seed 3", "--config and --seed"),
        ("train --config x.yaml --set algorithm.gamma=0.5", "--config and --set"),
    ],
)
def test_bad_commands(
    arguments: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("in the way")
    assert main(shlex.split(arguments)) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_the_shipped_studies_are_valid_and_balanced() -> None:
    assert {"paper", "smoke"} <= set(zoo_names("studies"))
    study = Study.load("paper")
    runs = list(study.runs())
    assert [run.variant for run in runs[:4]] == ["mappo", "ippo", "vdn", "qmix"]
    assert [run.seed for run in runs] == sorted([0, 1, 2, 3, 4] * 4)
    assert {run.config.algorithm.slots for run in runs} == {3_000_000}
    assert study.folder(Path("results"), runs[0]).path == Path("results/paper/mappo/seed-0")  # as `uavaou train`


def test_every_run_has_the_folder_that_train_gives_it(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    changed = "[{scenario: tiny, set: {uavs: 1, altitudes_m: [80], cds_m: [[0, 0]], layout_seed: 3}}]"
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: [7]").replace("[tiny]", changed)))
    monkeypatch.chdir(tmp_path)
    (first, _) = study.runs()
    sets = " ".join(f"--set algorithm.{item}" for item in SET.replace(": ", "=").split(", "))
    changed = "--set scenario.uavs=1 --set scenario.altitudes_m=[80.0] --set scenario.cds_m=[[0.0,0.0]]"
    assert main(shlex.split(f"train --scenario tiny {changed} --set scenario.layout_seed=3 --seed 7 --slots 192 {sets} "
                            "--quiet")) == 0  # fmt: skip
    assert study.folder(Path("results"), first).read_config() == first.config


def test_scenario_files_lie_beside_the_study(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write("base: tiny\nslots: 14\n", "valley.yaml")
    path = write(yaml.safe_dump(BASE | {"scenarios": ["valley.yaml"]}))
    monkeypatch.chdir("/")
    assert Study.load(path).scenarios == {"valley": Scenario.load("tiny").replace(slots=14, name="valley")}


# -- running it ----------------------------------------------------------------------------------------


class Inline:
    """Performs jobs in this process, and notes them."""

    def __init__(self, stop_after: int = 10**6, answer: Callable[[Job], Ended | None] = lambda job: None) -> None:
        self.done: list[Job] = []
        self._stop_after = stop_after
        self._answer = answer

    def events(self, take: Take, stopping: Callable[[], bool]) -> Events:
        while len(self.done) < self._stop_after and (job := take()) is not None:
            self.done.append(job)
            reports: list[Report] = []
            ended = self._answer(job) or outcome(job, reports.append)
            yield from (Advanced(job.key, report) for report in reports)
            yield ended

    @property
    def keys(self) -> list[Key]:
        return [job.key for job in self.done]


def run(study: Study, out: Path, engine: Inline) -> StudyOutcome:
    return run_study(study, out, engine, lambda standing: None, quiet=True)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Inline]:
    """A study run to its end, and what it did."""
    place = tmp_path_factory.mktemp("study")
    (place / "mine.yaml").write_text(TINY)
    engine = Inline()
    ended = run(Study.load(place / "mine.yaml"), place / "out", engine)
    assert ended == StudyOutcome(7, 7, {}, None)
    return place, engine


@pytest.fixture
def copied(finished: tuple[Path, Inline], tmp_path: Path) -> tuple[Study, Path]:
    shutil.copytree(finished[0], tmp_path / "copied")
    return Study.load(tmp_path / "copied" / "mine.yaml"), tmp_path / "copied" / "out"


def tables(out: Path) -> dict[str, bytes]:
    folder = out / "studies" / "mine"
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_order_is_by_seed_and_the_references_come_after_the_first(finished: tuple[Path, Inline]) -> None:
    assert finished[1].keys == [
        ("mappo", "tiny", 0), ("own critic", "tiny", 0), ("bound", "tiny", None), ("greedy", "tiny", None),
        ("plan", "tiny", None), ("anneal", "tiny", None), ("mappo", "tiny", 1), ("own critic", "tiny", 1),
    ]  # fmt: skip


def test_a_finished_study_does_nothing_and_changes_nothing(copied: tuple[Study, Path]) -> None:
    study, out = copied
    before = tables(out)
    engine = Inline()
    assert run(study, out, engine) == StudyOutcome(7, 7, {}, None)
    assert engine.done == []
    assert tables(out) == before


def test_the_condensed_results_are_enough_to_go_on_from(copied: tuple[Study, Path], finished: Any) -> None:
    study, out = copied
    shutil.rmtree(out / "tiny")
    shutil.rmtree(out / "planners")
    before = tables(out)
    more = Study.load(_rewritten(finished[0] / "mine.yaml", out.parent / "mine.yaml", "seeds: 2", "seeds: [0, 1, 5]"))
    engine = Inline()
    assert run(more, out, engine).done == 9
    assert engine.keys == [("mappo", "tiny", 5), ("own critic", "tiny", 5)]
    after = tables(out)
    for name in ("missions.csv", "runs.csv", "curves.csv"):
        assert set(before[name].splitlines()) < set(after[name].splitlines())
    assert list(study.scenarios) == ["tiny"]


def _rewritten(source: Path, target: Path, old: str, new: str) -> Path:
    text = source.read_text()
    assert old in text
    target.write_text(text.replace(old, new))
    return target


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("slots: 192", "slots: 240", "mappo on tiny with other settings"),
        ("episodes: 3", "episodes: 4", "episodes = 3, not 4"),
        ("seeds: 2", "seeds: 1", "seed 1, which the study lacks"),
        ("[greedy, anneal]", "[anneal]", "greedy on tiny, which the study lacks"),
        ("[tiny]", "[{scenario: tiny, name: tiny, set: {layout_seed: 5}}]", "tiny"),
        ("planning_seconds: 0.5", "planning_seconds: 900", "planners with planning_seconds = 0.5, not 900"),
        ("planning_seconds: 0.5", "planning_seconds: 0.25", "planners with planning_seconds = 0.5, not 0.25"),
    ],
)
def test_results_of_another_study_are_refused_and_kept(
    old: str, new: str, message: str, copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    path = _rewritten(out.parent / "mine.yaml", out.parent / "mine.yaml", old, new)
    before = tables(out)
    for command in ("run", "report", "status"):
        assert main(["study", command, str(path), "--out", str(out)]) == 2
        assert message in capsys.readouterr().err
    assert tables(out) == before


def test_planning_seconds_may_change_where_nothing_was_planned(write: Write, tmp_path: Path) -> None:
    small = TINY.replace("seeds: 2", "seeds: 1").replace("[greedy, anneal]", "[greedy]")
    assert run(Study.load(write(small)), tmp_path / "out", Inline()).done == 4
    longer = Study.load(write(small.replace("planning_seconds: 0.5", "planning_seconds: 0.75")))
    engine = Inline()
    assert run(longer, tmp_path / "out", engine).done == 4
    assert engine.done == []


@pytest.mark.parametrize("change", ["another action", "in mid-training", "of before they said what they are of"])
def test_an_evaluation_of_another_policy_or_action_is_not_taken(change: str, copied: tuple[Study, Path]) -> None:
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
    store, _ = report_study(study, out)
    assert Key("mappo", "tiny", 0) not in store
    engine = Inline()
    assert run(study, out, engine).failed == {}
    assert Key("mappo", "tiny", 0) in engine.keys
    assert Key("mappo", "tiny", 1) not in engine.keys
    after = tables(out)
    for name in ("missions.csv", "execution.csv", "devices.csv", "runs.csv"):
        assert after[name] == before[name]


def test_the_evaluation_of_the_command_line_is_as_good(copied: tuple[Study, Path]) -> None:
    study, out = copied
    before = tables(out)
    shutil.rmtree(out / "studies")
    for run_ in study.runs():
        path = study.folder(out, run_).path
        shutil.rmtree(path / "eval")
        assert main(["eval", str(path), "--episodes", "3", "--quiet"]) == 0
    engine = Inline()
    run(study, out, engine)
    assert not any(isinstance(job, Training) for job in engine.done)
    assert tables(out)["runs.csv"] == before["runs.csv"]


def test_a_best_checkpoint_that_is_damaged_is_told_and_stops_no_report(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    damaged = next(run for run in study.runs() if run.variant == "mappo" and f"seed-{run.seed}" == kept.name)
    best = study.folder(out, damaged).best
    best.write_bytes(best.read_bytes()[:-4] + b"ouch")
    before = tables(out)
    assert main(["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"left out: mappo on tiny, seed {damaged.seed}: {best}: damaged" in said
    after = tables(out)
    assert {name: after[name] for name in before} == before


def test_a_full_disk_is_a_failure_of_the_run_alone(write: Write, tmp_path: Path) -> None:
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: 1")))
    (tmp_path / "out/studies/mine/failures.csv.partial").mkdir(parents=True)  # nothing can be written in its place
    (tmp_path / "out/planners").write_text("in the way")
    said: list[str] = []
    engine = Inline(answer=lambda job: Ended(job.key, None, "no wind today") if job.key.variant == "mappo" else None)
    ended = run_study(study, tmp_path / "out", engine, lambda standing: said.extend(standing.news), quiet=True)
    assert ended.done == 3
    assert ended.failed[Key("mappo", "tiny", 0)] == "no wind today"
    assert f"no plan: cannot write '{tmp_path / 'out/planners/plans/tiny.json'}'" in ended.failed[Key("anneal", "tiny")]
    assert any("failures.csv" in line for line in said)


@pytest.mark.parametrize("command", ["run", "report"])
def test_results_that_cannot_be_written_are_one_line(
    command: str, copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    shutil.rmtree(out / "studies/mine")
    (out / "studies/mine").mkdir()
    (out / "studies/mine/configs").write_text("in the way")
    assert main(["study", command, str(out.parent / "mine.yaml"), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"cannot write to '{out / 'studies/mine'}'" in said


def test_what_is_at_work_is_shown(write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Planners and plans have no folder of their own whose lock could tell."""
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
        progress.show(standings[-1])
        lines[job.key.variant] = capsys.readouterr().err
        return None

    standings: list[Standing] = []
    run_study(study, out, Inline(answer=answer), standings.append, quiet=True)
    assert states["greedy"]["greedy"] == "running"
    assert states["greedy"]["anneal"] == "waiting"
    assert states["bound"]["bound"] == "running"
    assert states["plan"]["anneal"] == "running its plan is being annealed"
    assert states["anneal"]["anneal"] == "running"
    assert "3/5 done; at work: greedy for tiny" in lines["greedy"]
    assert "4/5 done" in lines["plan"]
    assert "at work: annealing a plan for tiny" in lines["plan"]
    assert not (out / "studies/mine/.working.csv").exists()


def test_what_a_killed_command_was_at_work_on_is_not(copied: tuple[Study, Path]) -> None:
    study, out = copied
    missions = out / "studies/mine/missions.csv"
    missions.write_text("".join(line for line in missions.open() if not line.startswith("greedy")))
    (out / "studies/mine/.working.csv").write_text("variant,scenario\ngreedy,tiny\n")
    states = {part.key.variant: part.state for part in study_status(study, out)}
    assert states["greedy"] == "waiting"
    run(study, out, Inline())
    assert not (out / "studies/mine/.working.csv").exists()


def test_a_run_that_fails_stops_no_other_and_is_tried_again(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.load(write(TINY))
    in_the_way = RunFolder(study.folder(tmp_path / "out", next(iter(study.runs()))).path)
    in_the_way.path.mkdir(parents=True)
    in_the_way.config.write_text("schema: 1\nseed: 1\n")
    engine = Inline(answer=lambda job: None if job.key.seed == 0 else Ended(job.key, None, "no wind today"))
    ended = run(study, tmp_path / "out", engine)
    assert ended.done == 1
    assert "part 'scenario' is missing" in ended.failed[Key("mappo", "tiny", 0)]
    assert ended.failed[Key("anneal", "tiny")] == "no plan: no wind today"
    assert ended.failed[Key("own critic", "tiny", 1)] == "no wind today"
    assert main(["study", "status", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "7 parts, 1 finished, 6 failed" in shown
    assert "own critic on tiny: no wind today" in shown
    in_the_way.config.unlink()
    assert run(study, tmp_path / "out", Inline()).failed == {}
    assert not (tmp_path / "out/studies/mine/failures.csv").exists()


def test_a_bug_in_one_run_keeps_its_traceback_and_stops_no_other(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.load(write(TINY.replace("seeds: 2", "seeds: 1").replace("[greedy, anneal]", "[]")))
    real = jobs._train
    monkeypatch.setattr(jobs, "_train", lambda job, tell: 1 // 0 if job.key.variant == "mappo" else real(job, tell))
    ended = run(study, tmp_path / "out", Inline())
    assert ended.done == 2
    assert "ZeroDivisionError" in ended.failed[Key("mappo", "tiny", 0)]
    assert "Traceback" in capsys.readouterr().err


def test_a_broken_run_goes_on_and_ends_as_the_whole_one(
    copied: tuple[Study, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from uavaou.runs import train as training

    study, out = copied
    real = training.train

    def broken(*arguments: Any, **options: Any) -> Any:
        def watch(standing: Any) -> None:
            if standing.slots >= 96:
                raise InputError("the lights went out")

        return real(*arguments, **(options | {"watch": watch, "checkpoint_every_s": 0}))

    monkeypatch.setattr(training, "train", broken)
    ended = run(study, tmp_path / "again", Inline())
    assert set(ended.failed.values()) == {"the lights went out"}
    monkeypatch.setattr(training, "train", real)
    engine = Inline()
    assert run(study, tmp_path / "again", engine).failed == {}
    assert {type(job) for job in engine.done} == {Training}  # planners and the bound were done before
    for name in ("missions.csv", "execution.csv", "devices.csv", "bounds.csv"):
        assert tables(tmp_path / "again")[name] == tables(out)[name]
    ours, theirs = (read_study(place / "studies/mine").curves for place in (tmp_path / "again", out))
    for column in set(ours) - {"wall_s"}:
        np.testing.assert_array_equal(ours[column], theirs[column])


def test_a_saved_plan_is_taken_unless_it_was_planned_for_less(copied: tuple[Study, Path]) -> None:
    study, out = copied
    plan = next((out / "planners/plans").glob("tiny.json"))
    stated = json.loads(plan.read_text())
    assert stated["planning_seconds"] == 0.5
    for name in ("missions", "execution"):  # as if anneal had not been evaluated
        path = out / f"studies/mine/{name}.csv"
        path.write_text("".join(line for line in path.open() if not line.startswith("anneal")))
    shutil.copytree(out, out.parent / "less")
    engine = Inline()
    run(study, out, engine)
    assert engine.keys == [("anneal", "tiny", None)]
    less = out.parent / "less"
    (less / "planners/plans/tiny.json").write_text(json.dumps(stated | {"planning_seconds": 0.1}))
    engine = Inline()
    run(study, less, engine)
    assert type(engine.done[0]) is Planning
    assert json.loads((less / "planners/plans/tiny.json").read_text())["planning_seconds"] == 0.5


def test_one_command_at_a_time_runs_a_study(copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]) -> None:
    study, out = copied
    run_folder = study.folder(out, next(iter(study.runs())))
    (out / "studies/mine/runs.csv").unlink()
    with one_writer(run_folder):
        assert "process" in str(holder(run_folder.lock))
        (first, *others) = study_status(study, out)
        assert (first.state, first.slots, first.budget) == ("running", 192, 192)
        assert first.rate is not None
        assert {part.state for part in others[:3]} == {"trained"}
        assert seconds_left([first, *others]) == 0
    assert holder(run_folder.lock) is None
    with one_writer(RunFolder(out / "studies/mine")):
        assert main(["study", "run", str(out.parent / "mine.yaml"), "--out", str(out)]) == 2
    assert "is being written by process" in capsys.readouterr().err


# -- the condensed results -----------------------------------------------------------------------------


def test_the_tables_say_what_the_run_folders_say(copied: tuple[Study, Path]) -> None:
    study, out = copied
    results = read_study(out / "studies/mine")
    scenario = study.scenarios["tiny"]
    tau = scenario.slot_length_s
    for run in study.runs():
        folder, place = study.folder(out, run), {"variant": run.variant, "scenario": "tiny", "seed": run.seed}
        evaluation = json.loads((folder.path / "eval/default.json").read_text())
        assert (evaluation["episodes"], evaluation["seed"]) == (3, 10_000)
        (entry,) = evaluation["policies"].values()
        missions = rows_of(results.missions, **place)
        np.testing.assert_allclose(missions["mean_aou_slots"], np.array(entry["mean_aou_s"]) / tau, rtol=1e-5)
        np.testing.assert_allclose(missions["reward_s"], -12 * np.array(entry["mean_aou_s"]), rtol=1e-5)
        execution = rows_of(results.execution, **place)
        assert execution["slot"].tolist() == list(range(1, 13))
        np.testing.assert_allclose(execution["mean_aou_slots"].mean(), missions["mean_aou_slots"].mean(), rtol=1e-5)
        devices = rows_of(results.devices, **place)
        np.testing.assert_allclose(devices["communications"].sum(), missions["communications"].mean(), rtol=1e-5)
        np.testing.assert_allclose(devices["x_m"], scenario.draw_layout().positions[:, 0], rtol=1e-5)
        row = rows_of(results.runs, **place)
        meta = json.loads(folder.meta.read_text())
        assert (row["slots"][0], row["agent_steps"][0]) == (meta["slots"], 2 * meta["slots"])
        np.testing.assert_allclose(row["best_slots"][0], meta["best_score"] / tau, rtol=1e-5)
        np.testing.assert_allclose(row["cpu_s"][0], meta["cpu_s"], rtol=1e-5)
        assert meta["cpu_s"] > 0
        with folder.episodes.open(newline="") as file:
            episodes = list(csv.DictReader(file))
        curve = rows_of(results.curves, **place)
        assert len(curve["slots"]) == len(episodes) == 16  # fewer than 200: a group each
        np.testing.assert_allclose(
            curve["mean_aou_slots"], [float(row["mean_aou_s"]) / tau for row in episodes], rtol=1e-5
        )
        validation = rows_of(results.validation, **place)
        assert validation["slots"].tolist() == [96, 192]
        assert min(validation["mean_aou_slots"].min(), validation["sampled_aou_slots"].min()) == row["best_slots"][0]


def test_planners_have_no_seed_and_stand_beside_a_bound(finished: tuple[Path, Inline]) -> None:
    results = read_study(finished[0] / "out/studies/mine")
    (bound,) = results.bounds["bound_slots"]
    for planner in ("greedy", "anneal"):
        missions = rows_of(results.missions, variant=planner, seed=NO_SEED)
        assert missions["mission"].tolist() == [0, 1, 2]
        assert (missions["mean_aou_slots"] >= bound * (1 - 1e-5)).all()
    assert results.study["evaluation_seed"] == 10_000


def test_long_curves_are_averaged_in_200_equal_groups(tmp_path: Path) -> None:
    from uavaou.studies.condense import _curve_rows

    rows = [f"{k},{10 * k},{k / 2},{-k},{k * 2.0},{k % 7},{3}" for k in range(1, 1001)]
    header = "mission,slots,wall_s,reward_s,mean_aou_s,communications,devices_served"
    (tmp_path / "episodes.csv").write_text("\n".join([header, *rows]) + "\n")
    scenario = Scenario.load("tiny").replace(slot_length_s=4)
    table = _curve_rows(Key("a", "b", 0), scenario, tmp_path / "episodes.csv")
    assert len(table) == 200
    assert table[0] == ["a", "b", "0", "50", "2.5", "-3", number(3 * 2 / 4), number((1 + 2 + 3 + 4 + 5) / 5), "3"]
    assert table[-1][3:5] == ["10000", "500"]


def test_the_best_by_validation_is_kept_and_can_be_played(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out = copied[1]
    results = read_study(out / "studies/mine")
    for variant in ("mappo", "own critic"):
        runs = rows_of(results.runs, variant=variant)
        best = int(runs["seed"][np.argmin(runs["best_slots"])])
        (kept,) = (out / "studies/mine/best/tiny" / variant).iterdir()
        assert kept.name == f"seed-{best}"
        mean = runs["mean_aou_slots"][runs["seed"] == best][0]
        card = (kept / "README.md").read_text()
        assert f"mean AoU {mean:.6g} slots" in card
        assert main(["eval", str(kept), "--episodes", "3", "--quiet", "--json", str(out / "x.json")]) == 0
        (entry,) = json.loads((out / "x.json").read_text())["policies"].values()
        tau = Scenario.load("tiny").slot_length_s
        np.testing.assert_allclose(np.mean(entry["mean_aou_s"]) / tau, mean, rtol=1e-5)
    capsys.readouterr()


def test_a_better_seed_takes_the_place_of_the_best(copied: tuple[Study, Path]) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    other = next(run for run in study.runs() if run.variant == "mappo" and f"seed-{run.seed}" != kept.name)
    meta = study.folder(out, other).meta
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"best_score": 0.001}))
    report_study(study, out)
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    assert kept.name == f"seed-{other.seed}"


@pytest.mark.parametrize("left", ["nothing", "other evaluations"])
def test_a_report_loses_nothing_where_runs_are_not_here(copied: tuple[Study, Path], left: str) -> None:
    """A fresh clone has the condensed results alone; ``uavaou eval`` may have replaced a run's evaluation."""
    study, out = copied
    before = tables(out)
    if left == "nothing":
        shutil.rmtree(out / "tiny")
    else:
        for path in out.glob("tiny/*/seed-*/eval/default.json"):
            path.write_text(json.dumps(json.loads(path.read_text()) | {"episodes": 500}))
    report_study(study, out)
    assert tables(out) == before


def test_the_kept_policy_stays_while_a_better_one_is_elsewhere(copied: tuple[Study, Path]) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    path = out / "studies/mine/runs.csv"
    rows = list(csv.DictReader(path.read_text().splitlines()))
    for row in rows:
        if row["variant"] == "mappo" and f"seed-{row['seed']}" != kept.name:
            row["best_slots"] = "0.001"
    lines = [list(rows[0]), *(list(row.values()) for row in rows)]
    path.write_text("".join(",".join(line) + "\n" for line in lines))
    shutil.rmtree(out / "tiny")
    report_study(study, out)
    assert [folder.name for folder in (out / "studies/mine/best/tiny/mappo").iterdir()] == [kept.name]


def test_a_run_of_its_kept_configuration_gives_the_same_figures(copied: tuple[Study, Path], tmp_path: Path) -> None:
    study, out = copied
    config = out / "studies/mine/configs/tiny/own critic/seed-1.yaml"
    assert main(["train", "--config", str(config), "--out", str(tmp_path / "again"), "--quiet"]) == 0
    run = next(run for run in study.runs() if (run.variant, run.seed) == ("own critic", 1))
    ours, theirs = (study.folder(place, run) for place in (tmp_path / "again", out))
    for name in ("episodes.csv", "progress.csv"):
        with (ours.path / name).open() as one, (theirs.path / name).open() as other:
            rows = [
                [{k: v for k, v in row.items() if "wall" not in k} for row in csv.DictReader(file)]
                for file in (one, other)
            ]
        assert rows[0] == rows[1]
        assert rows[0]


def test_the_report_prints_every_variant_and_planner(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    study, out = copied
    before = tables(out)
    assert main(["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    for name in (*study.variants, *study.planners, "lower bound"):
        assert any(line.startswith(f"{name} ") for line in shown.splitlines())
    after = tables(out)
    assert {name: after[name] for name in before} == before
    missions = {f"mission-{variant}.json" for variant in study.variants}
    assert after.keys() - before.keys() == {"README.md", "marl-eval.json", *missions}


def test_the_report_says_what_is_wrong_with_its_results(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    (out / "studies/mine/bounds.csv").write_text("scenario,bound_slots,method\ntiny,100000,x\n")
    assert main(["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert "uavaou: 'mappo' on 'tiny' has a mean AoU of " in said
    assert "below the certified bound of 1e+05" in said


def test_a_study_that_runs_is_reported_from_its_tables(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    command = ["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]
    before = tables(out)
    with one_writer(RunFolder(out / "studies/mine")):
        assert main(command) == 0
    shown = capsys.readouterr()
    assert shown.err.count("\n") == 1
    assert "is at work on the study: its page is written from the tables as they stand" in shown.err
    assert "own critic" in shown.out
    after = tables(out)
    assert after.keys() - before.keys() == {"README.md", "marl-eval.json"}
    assert {name: after[name] for name in before if name != ".lock"} == {
        name: content for name, content in before.items() if name != ".lock"
    }
    page = after["README.md"]
    assert main(command) == 0
    assert tables(out)["README.md"] == page


@pytest.mark.parametrize("after", range(1, len(COLUMNS)))
def test_tables_that_grow_while_they_are_read_have_what_they_name(
    after: int, copied: tuple[Study, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are written one after another, runs last."""
    from uavaou.studies import results as study_results
    from uavaou.studies.tables import by_run

    folder = copied[1] / "studies/mine"
    whole = {name: (folder / f"{name}.csv").read_text() for name in COLUMNS}
    for name, text in whole.items():
        kept = [line for line in text.splitlines(keepends=True) if not line.startswith(("own critic", "greedy"))]
        (folder / f"{name}.csv").write_text("".join(kept))
    real, read = study_results.read_table, []

    def growing(path: Path, columns: tuple[str, ...]) -> Any:
        table = real(path, columns)
        read.append(path)
        if len(read) == after:
            for name, text in whole.items():
                (folder / f"{name}.csv").write_text(text)
        return table

    monkeypatch.setattr(study_results, "read_table", growing)
    found = by_run(read_study(folder))
    for name in (*found.algorithms, *found.planners):
        assert found.stack("missions", name, "tiny", "mean_aou_slots").size
        assert found.stack("execution", name, "tiny", "mean_aou_slots").size


def test_an_interrupt_in_a_compiled_function_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def perform(*_: object) -> None:
        raise SystemError("CPUDispatcher(...) returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("uavaou.studies.processes.perform", perform)
    job = Planning(Key("anneal", "tiny"), Scenario.load("tiny"), 1.0)
    assert outcome(job, lambda report: None) == Ended(job.key, None)


@pytest.mark.parametrize("there", ["nothing", "a damaged run", "empty tables"])
def test_a_report_of_nothing_says_so_and_writes_nothing(
    there: str, write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    path = write(TINY)
    study = Study.load(path)
    if there == "empty tables":
        StudyStore(study_folder(out, study)).write(study)
    elif there == "a damaged run":
        folder = study.folder(out, next(iter(study.runs())))
        folder.path.mkdir(parents=True)
        folder.config.write_text("schema: [1\n")
    before = sorted(out.rglob("*"))
    assert main(["study", "report", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert "nothing of study 'mine' has been evaluated" in said[-1]
    if there == "a damaged run":
        assert "left out: mappo on tiny, seed 0" in said[0]
        assert "YAML" in said[0]
    assert len(said) == (2 if there == "a damaged run" else 1)
    assert sorted(out.rglob("*")) == before


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("runs.csv", lambda text: None, "cannot be read"),
        ("missions.csv", lambda text: text.replace("variant", "varriant"), "expected the columns variant, "),
        ("execution.csv", lambda text: text + "mappo,tiny\n", "2 values, expected 5"),
        ("curves.csv", lambda text: text.replace("mappo,tiny,0", "mappo,tiny,x", 1), "column 'seed'"),
        ("bounds.csv", lambda text: "scenario,bound_slots,method\ntiny,nan,x\n", "line 2, column 'bound_slots'"),
        ("devices.csv", lambda text: "", "expected the columns"),
        ("study.yaml", lambda text: None, "holds no study.yaml"),
    ],
)
def test_damaged_results_are_named(
    name: str, spoil: Callable[[str], str | None], message: str, copied: tuple[Study, Path]
) -> None:
    folder = copied[1] / "studies/mine"
    text = spoil((folder / name).read_text())
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text)
    with pytest.raises(InputError, match="mine") as caught:
        read_study(folder)
    assert message in str(caught.value)


def test_what_was_cut_off_between_two_tables_is_done_again(copied: tuple[Study, Path]) -> None:
    study, out = copied
    shutil.rmtree(out / "tiny")
    runs = out / "studies/mine/runs.csv"
    runs.write_text("".join(line for line in runs.open() if not line.startswith("mappo,mappo,tiny,1")))
    states = {part.key: part.state for part in study_status(study, out)}
    assert states.pop(Key("mappo", "tiny", 1)) == "waiting"
    assert set(states.values()) == {"finished"}
    engine = Inline()
    run(study, out, engine)
    assert engine.keys == [("mappo", "tiny", 1)]
    assert len(read_study(out / "studies/mine").missions["mission"]) == 3 * (4 + 2)


def test_figures_have_six_digits() -> None:
    values = [0.123456789, 123456789.0, 3.0, -1.5e7, float("nan"), None]
    assert [number(value) for value in values] == ["0.123457", "123456789", "3", "-15000000", "", ""]


def test_the_columns_are_those_that_others_read() -> None:
    assert COLUMNS["runs"] == (
        "variant", "algorithm", "scenario", "seed", "slots", "agent_steps", "wall_s", "cpu_s", "best_slots",
        "mean_aou_slots", "low", "high", "violations", "commit",
    )  # fmt: skip
    assert list(COLUMNS)[-1] == "runs"  # written last: a run counts by its row here
    assert reference_keys(Study.load("paper"))[0] == Key("bound", "paper")
