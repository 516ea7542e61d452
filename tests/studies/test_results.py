"""A study's condensed results: what the tables hold, the kept policies, the report, and damaged files."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.runs.stopped_runs import without_wall
from tests.studies.tiny_study import TINY, Inline, Write, run_inline, tables
from uavaou import InputError, Scenario
from uavaou.algorithms.registry import config_from_dict
from uavaou.csv_tables import number
from uavaou.runs.lock import one_writer
from uavaou.studies.condense import update_results
from uavaou.studies.folder import PartKey, StudyFolder
from uavaou.studies.jobs import Ended, Planning
from uavaou.studies.processes import outcome
from uavaou.studies.results import COLUMNS, read_begun, read_study
from uavaou.studies.status import study_status
from uavaou.studies.study import Study
from uavaou_cli.main import main


@pytest.mark.slow
def test_the_tables_agree_with_the_run_folders(copied: tuple[Study, Path]) -> None:
    study, out = copied
    results = read_study(out / "studies/mine")
    scenario = study.scenarios["tiny"]
    tau = scenario.slot_length_s
    for run in study.runs():
        folder, place = study.folder(out, run), run.key._asdict()
        evaluation = json.loads((folder.path / "eval/default.json").read_text())
        assert (evaluation["episodes"], evaluation["seed"]) == (3, 10_000)
        (entry,) = evaluation["policies"].values()
        missions = results.table("missions", **place)
        np.testing.assert_allclose(missions["mean_aou_slots"], np.array(entry["mean_aou_s"]) / tau, rtol=1e-5)
        np.testing.assert_allclose(missions["reward_s"], -12 * np.array(entry["mean_aou_s"]), rtol=1e-5)
        execution = results.table("execution", **place)
        assert execution["slot"].tolist() == list(range(1, 13))
        np.testing.assert_allclose(execution["mean_aou_slots"].mean(), missions["mean_aou_slots"].mean(), rtol=1e-5)
        devices = results.table("devices", **place)
        np.testing.assert_allclose(devices["communications"].sum(), missions["communications"].mean(), rtol=1e-5)
        np.testing.assert_allclose(devices["x_m"], scenario.draw_layout().positions[:, 0], rtol=1e-5)
        row = results.table("runs", **place)
        meta = json.loads(folder.meta.read_text())
        assert (row["slots"][0], row["agent_steps"][0]) == (meta["slots"], 2 * meta["slots"])
        np.testing.assert_allclose(row["best_slots"][0], meta["best_score"] / tau, rtol=1e-5)
        np.testing.assert_allclose(row["cpu_s"][0], meta["cpu_s"], rtol=1e-5)
        assert meta["cpu_s"] > 0
        with folder.episodes.open(newline="") as file:
            episodes = list(csv.DictReader(file))
        curve = results.table("curves", **place)
        assert len(curve["slots"]) == len(episodes) == 16  # fewer than 200: a group each
        np.testing.assert_allclose(
            curve["mean_aou_slots"], [float(row["mean_aou_s"]) / tau for row in episodes], rtol=1e-5
        )
        validation = results.table("validation", **place)
        start = [0] if getattr(run.config.algorithm, "pull", 0) else []  # is validated too
        assert validation["slots"].tolist() == [*start, 96, 192]
        assert min(validation["mean_aou_slots"].min(), validation["sampled_aou_slots"].min()) == row["best_slots"][0]


def test_planners_have_no_seed_and_respect_the_bound(finished: tuple[Path, Inline]) -> None:
    results = read_study(finished[0] / "out/studies/mine")
    bound = results.bounds["tiny"]
    for planner in ("greedy", "anneal"):
        missions = results.table("missions", planner)
        assert missions["mission"].tolist() == [0, 1, 2]
        assert (missions["mean_aou_slots"] >= bound * (1 - 1e-5)).all()
    assert results.settings["evaluation_seed"] == 10_000


def test_long_curves_are_averaged_in_200_equal_groups(tmp_path: Path) -> None:
    from uavaou.studies.condense import curve_rows

    rows = [f"{k},{10 * k},{k / 2},{-k},{k * 2.0},{k % 7},{3}" for k in range(1, 1001)]
    header = "mission,slots,wall_s,reward_s,mean_aou_s,communications,devices_served"
    (tmp_path / "episodes.csv").write_text("\n".join([header, *rows]) + "\n")
    scenario = Scenario.load("tiny").replace(slot_length_s=4)
    table = curve_rows(PartKey("a", "b", 0), scenario, tmp_path / "episodes.csv")
    assert len(table) == 200
    assert table[0] == ["a", "b", "0", "50", "2.5", "-3", number(3 * 2 / 4), number((1 + 2 + 3 + 4 + 5) / 5), "3"]
    assert table[-1][3:5] == ["10000", "500"]


def test_the_best_by_validation_is_kept_and_can_be_played(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out = copied[1]
    results = read_study(out / "studies/mine")
    for variant in ("mappo", "own critic"):
        runs = results.table("runs", variant=variant)
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
    other = next(run for run in study.runs() if run.key.variant == "mappo" and f"seed-{run.key.seed}" != kept.name)
    meta = study.folder(out, other).meta
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"best_score": 0.001}))
    update_results(study, out)
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    assert kept.name == f"seed-{other.key.seed}"


@pytest.mark.parametrize("left", ["nothing", "other evaluations"])
def test_a_report_without_run_folders_keeps_all_rows(copied: tuple[Study, Path], left: str) -> None:
    """A fresh clone has the condensed results alone; ``uavaou eval`` may have replaced a run's evaluation."""
    study, out = copied
    before = tables(out)
    if left == "nothing":
        shutil.rmtree(out / "tiny")
    else:
        for path in out.glob("tiny/*/seed-*/eval/default.json"):
            path.write_text(json.dumps(json.loads(path.read_text()) | {"episodes": 500}))
    update_results(study, out)
    assert tables(out) == before


def test_the_kept_policy_stays_while_the_folder_of_a_better_one_is_missing(copied: tuple[Study, Path]) -> None:
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
    update_results(study, out)
    assert [folder.name for folder in (out / "studies/mine/best/tiny/mappo").iterdir()] == [kept.name]


def test_training_from_a_kept_configuration_gives_the_same_results(copied: tuple[Study, Path], tmp_path: Path) -> None:
    study, out = copied
    config = out / "studies/mine/configs/tiny/own critic.yaml"
    assert main(["train", "--config", str(config), "--seed", "1", "--out", str(tmp_path / "again"), "--quiet"]) == 0
    run = next(run for run in study.runs() if (run.key.variant, run.key.seed) == ("own critic", 1))
    ours, theirs = (study.folder(place, run) for place in (tmp_path / "again", out))
    for name in ("episodes.csv", "progress.csv"):
        assert without_wall(ours.path / name) == without_wall(theirs.path / name) != []


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
    assert after.keys() - before.keys() == {"README.md", "marl-eval.json", "replay.html", "trainings.csv", *missions}


def test_the_report_warns_of_results_below_the_bound(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    (out / "studies/mine/bounds.csv").write_text("scenario,bound_slots,method\ntiny,100000,x\n")
    assert main(["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr().err
    assert "uavaou: 'mappo' on 'tiny' has a mean AoU of " in said
    assert "below the certified bound of 100,000" in said


def test_a_running_study_is_reported_from_its_tables(
    copied: tuple[Study, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _, out = copied
    command = ["study", "report", str(out.parent / "mine.yaml"), "--out", str(out)]
    before = tables(out)
    with one_writer(out / "studies/mine"):
        assert main(command) == 0
    shown = capsys.readouterr()
    assert shown.err.count("\n") == 1
    assert "is at work on the study: its page is written from the tables as they stand" in shown.err
    assert "own critic" in shown.out
    after = tables(out)
    assert after.keys() - before.keys() == {"README.md", "marl-eval.json", "trainings.csv"}
    assert {name: after[name] for name in before if name != ".lock"} == {
        name: content for name, content in before.items() if name != ".lock"
    }
    page = after["README.md"].split(b"\n\n")
    assert main(command) == 0
    finished = tables(out)["README.md"].split(b"\n\n")
    assert [part for part in finished if b"replay.html" not in part] == page  # it may record missions only now


@pytest.mark.parametrize("after", range(1, len(COLUMNS)))
def test_tables_that_grow_while_they_are_read_are_consistent(
    after: int, copied: tuple[Study, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are written one after another, runs last."""
    from uavaou.studies import results as study_results

    folder = copied[1] / "studies/mine"
    whole = {name: (folder / f"{name}.csv").read_text() for name in COLUMNS}
    for name, text in whole.items():
        kept = [line for line in text.splitlines(keepends=True) if not line.startswith(("own critic", "greedy"))]
        (folder / f"{name}.csv").write_text("".join(kept))
    real, read = study_results.read_csv, []

    def growing(path: Path, columns: tuple[str, ...], **options: Any) -> Any:
        table = real(path, columns, **options)
        read.append(path)
        if len(read) == after:
            for name, text in whole.items():
                (folder / f"{name}.csv").write_text(text)
        return table

    monkeypatch.setattr(study_results, "read_csv", growing)
    found = read_study(folder)
    for name in (*found.algorithms, *found.planners):
        assert found.stack("missions", name, "tiny", "mean_aou_slots").size
        assert found.stack("execution", name, "tiny", "mean_aou_slots").size


def test_an_interrupt_in_a_compiled_function_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def perform(*_: object) -> None:
        raise SystemError("CPUDispatcher(...) returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(Planning, "perform", perform)
    job = Planning(PartKey("anneal", "tiny"), Scenario.load("tiny"), 1.0)
    assert outcome(job, lambda report: None) == Ended(job.key, None)


@pytest.mark.parametrize("there", ["nothing", "a damaged run", "empty tables"])
def test_a_report_without_results_is_refused_and_writes_nothing(
    there: str, write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    path = write(TINY)
    study = Study.load(path)
    if there == "empty tables":
        read_begun(StudyFolder.of(out, study.name)).write(study)
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
        ("missions.csv", lambda text: text.replace("variant", "varriant"), "column 'variant' is missing"),
        ("execution.csv", lambda text: text + "mappo,tiny\n", "2 values, expected 5"),
        ("curves.csv", lambda text: text.replace("mappo,tiny,0", "mappo,tiny,x", 1), "column 'seed'"),
        ("bounds.csv", lambda text: "scenario,bound_slots,method\ntiny,nan,x\n", "line 2, column 'bound_slots'"),
        ("execution.csv", lambda text: text.replace("variant,scenario", "scenario,variant"), "expected the columns"),
        ("devices.csv", lambda text: "", "column 'variant' is missing"),
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


def test_tables_from_before_a_column_are_read(copied: tuple[Study, Path]) -> None:
    runs = copied[1] / "studies/mine/runs.csv"
    before = read_study(runs.parent).table("runs")
    runs.write_text("".join(line.rpartition(",")[0] + "\n" for line in runs.open()))
    after = read_study(runs.parent).table("runs")
    assert set(before["processor"]) != {""} == set(after["processor"])
    assert all((before[name] == after[name]).all() for name in before if name != "processor")


def test_a_part_cut_off_between_two_tables_is_done_again(copied: tuple[Study, Path]) -> None:
    study, out = copied
    shutil.rmtree(out / "tiny")
    runs = out / "studies/mine/runs.csv"
    runs.write_text("".join(line for line in runs.open() if not line.startswith("mappo,mappo,tiny,1")))
    states = {part.key: part.state for part in study_status(study, out)}
    assert states.pop(PartKey("mappo", "tiny", 1)) == "waiting"
    assert set(states.values()) == {"finished"}
    engine = Inline()
    run_inline(study, out, engine)
    assert engine.keys == [("mappo", "tiny", 1)]
    assert len(read_study(out / "studies/mine").table("missions")["mission"]) == 3 * (4 + 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "default"])
def test_committed_tables_are_rewritten_to_the_same_bytes(name: str, tmp_path: Path) -> None:
    committed = Path(__file__).resolve().parents[2] / "results/studies" / name
    results = read_study(committed)
    results.folder = StudyFolder(tmp_path)
    results.write(Study.load(name))
    for table in COLUMNS:
        assert (tmp_path / f"{table}.csv").read_bytes() == (committed / f"{table}.csv").read_bytes(), table
    variants: Any = results.settings["variants"]  # a field that is newer than the file has its default
    full = {variant: config_from_dict(fields, tmp_path).model_dump(mode="json") for variant, fields in variants.items()}
    assert read_study(tmp_path).settings == {**results.settings, "variants": full}


def test_numbers_have_six_digits() -> None:
    values = [0.123456789, 123456789.0, 3.0, -1.5e7, float("nan"), None]
    assert [number(value) for value in values] == ["0.123457", "123456789", "3", "-15000000", "", ""]


def test_the_columns_keep_their_names() -> None:
    assert COLUMNS["runs"] == (
        "variant", "algorithm", "scenario", "seed", "slots", "agent_steps", "wall_s", "cpu_s", "best_slots",
        "mean_aou_slots", "low", "high", "violations", "commit", "processor",
    )  # fmt: skip
    assert list(COLUMNS)[-1] == "runs"  # written last: a run counts by its row here
    assert Study.load("paper").planner_parts()[0] == PartKey("bound", "paper")
