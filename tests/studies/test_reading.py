"""A study's results as they are looked up, its kept policies, and its export for marl-eval."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.synthetic_study import MAPPO, PLANNERS, SLOT_S, VDN, K, record, write_study
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import read_mission, record_mission, write_mission
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import load_run
from uavaou.scenario import Scenario
from uavaou.studies.best import record_missions
from uavaou.studies.marl_eval import to_marl_eval
from uavaou.studies.results import read_study, study_folders
from uavaou_cli.main import main


def test_runs_that_are_not_finished_are_left_out(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", seeds=3)
    runs = (folder / "runs.csv").read_text().splitlines(keepends=True)
    (folder / "runs.csv").write_text("".join(row for row in runs if not row.startswith("mappo,mappo,paper,1,")))
    study = read_study(folder)
    assert study.stack("missions", "mappo", "paper", "mean_aou_slots").shape == (2, 12)
    assert study.stack("missions", "vdn", "paper", "mean_aou_slots").shape == (3, 12)


def test_seeds_of_different_lengths_cannot_be_stacked(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    text = (folder / "missions.csv").read_text().splitlines(keepends=True)
    (folder / "missions.csv").write_text("".join([text[0], *text[2:]]))
    with pytest.raises(InputError, match=r"missions\.csv.*'mappo' on 'paper'"):
        read_study(folder).stack("missions", "mappo", "paper", "mean_aou_slots")


def test_studies_are_found_and_the_papers_is_first(tmp_path: Path) -> None:
    for name in ("other", "paper", "ablation"):
        write_study(tmp_path / "studies" / name, {"mappo": MAPPO}, seeds=1, missions=2)
    assert [folder.name for folder in study_folders(tmp_path)] == ["paper", "ablation", "other"]


# -- marl-eval -----------------------------------------------------------------------------------------


def test_export_has_the_structure_that_marl_eval_describes(tmp_path: Path) -> None:
    variants = {"mappo": MAPPO, "vdn": VDN}
    folder = write_study(tmp_path / "study", variants, PLANNERS, seeds=3, scenarios=("a", "b"))
    results = read_study(folder)
    content = json.loads(json.dumps(to_marl_eval(results)))
    assert list(content) == ["uavaou_v0"]
    assert set(content["uavaou_v0"]) == {"a", "b"}
    for algorithms in content["uavaou_v0"].values():
        assert set(algorithms) == {"mappo", "vdn"}  # planners have no training
        for runs in algorithms.values():
            assert set(runs) == {"seed_0", "seed_1", "seed_2"}
            for run in runs.values():
                check_run(run)
    run = content["uavaou_v0"]["b"]["vdn"]["seed_1"]
    study = read_study(folder)
    aou = study.stack("missions", "vdn", "b", "mean_aou_slots")[1].mean()
    assert run["absolute_metrics"]["mean_aou_slots"] == [pytest.approx(aou)]
    assert run["absolute_metrics"]["return"] == [pytest.approx(-aou * K * SLOT_S)]
    assert run["step_4"]["step_count"] == study.runs("validation", "vdn", "b")[1]["slots"][4]


def check_run(run: dict[str, Any]) -> None:
    steps = [key for key in run if key != "absolute_metrics"]
    assert steps == [f"step_{k}" for k in range(len(steps))]
    assert len(steps) == 30
    counts = [run[step]["step_count"] for step in steps]
    assert counts == sorted(counts)
    assert all(isinstance(count, int) for count in counts)
    for step in steps:
        for metric in set(run[step]) - {"step_count", "elapsed_time"}:
            assert isinstance(run[step][metric], list)
            assert len(run[step][metric]) == 1
            assert metric in run["absolute_metrics"]
    assert all(isinstance(values, list) for values in run["absolute_metrics"].values())


def test_export_keeps_the_runs_and_steps_that_all_have(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", {"mappo": MAPPO, "vdn": VDN}, seeds=3)
    for name, part in (("runs.csv", "vdn,vdn,paper,2,"), ("validation.csv", "mappo,paper,1,60000,")):
        rows = (folder / name).read_text().splitlines(keepends=True)
        kept = [row for row in rows if not row.startswith(part)]
        assert len(kept) == len(rows) - 1
        (folder / name).write_text("".join(kept))
    tasks = to_marl_eval(read_study(folder))["uavaou_v0"]
    assert {len(runs) for runs in tasks["paper"].values()} == {2}
    assert {len(run) for runs in tasks["paper"].values() for run in runs.values()} == {30}  # 29 steps and the last


def test_tables_of_a_study_without_runs_are_an_input_error(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", {}, {}, bound=None)
    with pytest.raises(InputError, match="no evaluated run"):
        read_study(folder).require_evaluated()


# -- kept policies ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_kept_policies_of_a_study_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    small = "missions=2 rollout_slots=12 batch_rows=24 evaluate_every_slots=24 evaluation_missions=2"
    options = [word for setting in small.split() for word in ("--set", f"algorithm.{setting}")]
    assert main(["train", "--scenario", "tiny", "--slots", "48", "--seed", "3", "--quiet", *options]) == 0
    trained = next(tmp_path.glob("results/tiny/*/seed-3"))
    study = write_study(tmp_path / "study", {"mappo": MAPPO}, seeds=1, scenarios=("none kept", "a%b"))
    assert record_missions(study) == []
    shutil.copytree(trained, study / "best" / "a%25b" / "big mappo" / "seed-3")
    record(study, "of tiny")
    other = record(study, "of another")
    write_mission(
        study / "mission-of another.json", replace(other, scenario=other.scenario.replace(rate_min_bit_s=1000))
    )
    assert record_missions(study) == [study / "mission-big mappo.json"]
    assert {path.name for path in study.glob("mission-*")} == {"mission-big mappo.json", "mission-of tiny.json"}
    mission = read_mission(study / "mission-big mappo.json")
    assert (mission.policy, mission.training_seed, mission.mission_seed) == ("big mappo", 3, 10_000)
    played = record_mission(Scenario.load("tiny"), load_run(RunFolder(trained)), 10_000)
    np.testing.assert_array_equal(mission.recording.collected_by, played.collected_by)
    np.testing.assert_allclose(mission.recording.age_sum, played.age_sum)
