"""A study as it runs: the order, what is skipped, resumed, refused and failed, its tables and its status."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli.commands import Shell
from tests.experiments.small import SET, TINY, Inline, Write, rewritten, run_inline, tables
from tests.runs.stopped_runs import without_wall
from tests.synthetic_study import edit, set_to, without
from uavaou import Scenario, read_study
from uavaou.evaluation.flights import DEVICES, SAMPLED, SLOTS, TRAINING, VALIDATION, Flights, PartKey
from uavaou.experiments.jobs import Training
from uavaou.experiments.run import expected_cpu_s, gather, study_status, update_results
from uavaou.experiments.study import Study
from uavaou.runs.flights import training_curves
from uavaou.runs.folder import RunFolder
from uavaou.runs.lock import one_writer
from uavaou.runs.names import config_folder
from uavaou_cli.main import main


def run_folder(study: Study, out: Path, variant: str = "mappo", seed: int = 0) -> RunFolder:
    return config_folder(out, dict(study.runs())[PartKey(variant, "tiny", seed)])


def states_of(study: Study, out: Path) -> dict[str, str]:
    return {str(part.key): part.state for part in study_status(study, out)}


def test_planners_come_after_the_first_seed_and_before_the_others(finished: tuple[Path, Inline]) -> None:
    order = ["mappo 0", "ippo 0", "greedy", "anneal", "bound", "mappo 1", "ippo 1"]
    assert finished[1].names == order


def test_a_finished_study_does_nothing_and_changes_nothing(copied: tuple[Study, Path], shell: Shell) -> None:
    study, out = copied
    before, executor = tables(out), Inline()
    ended = run_inline(study, out, executor)
    assert (ended.done, ended.total, ended.failed, ended.stopped_by) == (7, 7, {}, None)
    assert executor.done == []
    assert tables(out) == before
    file = out.parent / "mine.yaml"
    said = " ".join(shell.out(f"study run {file} --out {out} --quiet").split())
    again = f"uavaou study run {file} --out {out}-again"
    assert f"nothing was trained: all 7 parts have results already. All of them again: {again} next:" in said
    assert said.endswith(f"next: uavaou study report {file} --out {out}")
    without(out / "studies/mine", policy="bound")  # now one part is done
    assert "nothing was trained" not in shell.out(f"study run {file} --out {out} --quiet")


def test_a_study_resumes_from_its_tables_alone(copied: tuple[Study, Path]) -> None:
    _, out = copied
    shutil.rmtree(out / "tiny")
    before = Flights.read(out / "studies/mine").flights
    file = rewritten(out.parent / "mine.yaml", out.parent / "mine.yaml", "seeds: 2", "seeds: [0, 1, 5]")
    executor = Inline()
    assert run_inline(Study.load(file), out, executor).done == 9
    assert executor.names == ["mappo 5", "ippo 5"]
    after = Flights.read(out / "studies/mine").flights
    assert after[(after["seed"] != 5).fillna(True)].reset_index(drop=True).equals(before)


@pytest.mark.parametrize(
    ("old", "new", "who"),
    [
        ("slots: 192", "slots: 240", "mappo"),
        ("episodes: 3", "episodes: 4", "greedy"),
        ("seeds: 2", "seeds: 1", "mappo"),
        ("[greedy, anneal]", "[anneal]", "greedy"),
        ("[tiny]", "[{scenario: tiny, name: tiny, set: {layout_seed: 5}}]", "greedy"),
        ("planning_seconds: 0.2", "planning_seconds: 0.25", "anneal"),
    ],
)
def test_results_of_another_study_are_refused_and_kept(
    old: str, new: str, who: str, copied: tuple[Study, Path], shell: Shell
) -> None:
    _, out = copied
    path = rewritten(out.parent / "mine.yaml", out.parent / "mine.yaml", old, new)
    before = tables(out)
    for command in ("run", "report", "status"):
        said = shell.refused(f"study {command} {path} --out {out}")
        assert f"holds results of {who} on tiny" in said
        assert "another --out" in said
    assert tables(out) == before


# -- what other studies have ---------------------------------------------------------------------------


def another(place: Path, old: str = "", new: str = "") -> Study:
    """The same trainings and planners under other names."""
    text = TINY.replace("  mappo:", "  shared critic:").replace("[tiny]", "[{scenario: tiny, name: small}]")
    text = text.replace("shared critic: {set", "shared critic: {algorithm: mappo, set").replace(old, new)
    (place / "another.yaml").write_text(text)
    return Study.load(place / "another.yaml")


def test_what_another_study_has_is_not_done_again(copied: tuple[Study, Path]) -> None:
    _, out = copied
    shutil.rmtree(out / "tiny")
    executor = Inline()
    ended = run_inline(another(out.parent), out, executor)
    assert (executor.done, ended.done, ended.total) == ([], 7, 7)
    own, others = read_study(out / "studies/another"), read_study(out / "studies/mine")
    assert list(own.algorithms) == ["shared critic", "own critic"]
    for name, other in (("shared critic", "mappo"), ("greedy", "greedy")):
        np.testing.assert_array_equal(own.stack(name, "small"), others.stack(other, "tiny"))


@pytest.mark.parametrize(
    ("old", "new", "left"),
    [
        ("episodes: 3", "episodes: 4", {"own critic", "shared critic", "greedy", "anneal"}),
        ("slots: 192", "slots: 240", {"own critic", "shared critic"}),
        ("seconds: 0.2", "seconds: 0.3", {"anneal"}),
    ],
)
def test_what_differs_is_not_taken_over(copied: tuple[Study, Path], old: str, new: str, left: set[str]) -> None:
    _, out = copied
    study = another(out.parent, old, new)
    results, _ = gather(study, out)
    assert {key.policy for key in study.table_order() if key not in results.parts} == left


def test_the_time_is_that_of_trainings_of_the_same_kind(copied: tuple[Study, Path]) -> None:
    _, out = copied
    known = read_study(out / "studies/mine")
    rates = [known.trainings(name, "tiny")["cpu_s"].mean() / 192 for name in known.algorithms]
    study = another(out.parent, "slots: 192", "slots: 240")
    nothing, _ = gather(study, out)
    cpu_s, unknown = expected_cpu_s(study, nothing, out)
    assert cpu_s == pytest.approx(2 * 240 * sum(rates), rel=1e-4)
    assert unknown == []
    wider = another(out.parent, SET, SET.replace("[8]", "[8, 8]"))
    assert expected_cpu_s(wider, nothing, out)[1] == ["mappo set 8 8", "ippo mlp 8 8"]
    assert expected_cpu_s(study, nothing, out / "nowhere") == (0.0, ["mappo set 8", "ippo mlp 8"])


# -- evaluations ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", ["another action", "in mid-training", "of more missions"])
def test_flights_of_another_policy_or_action_are_ignored(change: str, copied: tuple[Study, Path]) -> None:
    """What ``uavaou eval`` wrote in the middle of the training, or with ``--action``, has as many missions."""
    study, out = copied
    before = read_study(out / "studies/mine")
    shutil.rmtree(out / "studies")
    first = run_folder(study, out).path
    if change == "in mid-training":
        edit(first, lambda table: Flights(table.flights.assign(digest="0" * 64, mean_aou_slots=1.0), table.curves))
    else:
        other = {"greedy": "sample", "sample": "greedy"}[Flights.read(first).flights["action"].iloc[0]]
        options = ["--action", other, "--episodes", "3"] if change == "another action" else ["--episodes", "4"]
        assert main(["eval", str(first), "--quiet", *options]) == 0
    results, _ = update_results(study, out)
    assert PartKey("mappo", "tiny", 0) not in results.parts
    executor = Inline()
    assert run_inline(study, out, executor).failed == {}
    assert "mappo 0" in executor.names
    assert "mappo 1" not in executor.names
    np.testing.assert_array_equal(
        read_study(out / "studies/mine").stack("mappo", "tiny"), before.stack("mappo", "tiny")
    )


def test_an_evaluation_by_the_eval_command_counts(copied: tuple[Study, Path]) -> None:
    study, out = copied
    before = read_study(out / "studies/mine").table.where(policy="mappo").flights
    shutil.rmtree(out / "studies")
    for _, config in study.runs():
        path = config_folder(out, config).path
        (path / "flights.csv.gz").unlink()
        assert main(["eval", str(path), "--episodes", "3", "--quiet"]) == 0
    executor = Inline()
    run_inline(study, out, executor)
    assert not any(isinstance(job, Training) for job in executor.done)
    assert read_study(out / "studies/mine").table.where(policy="mappo").flights.equals(before)


@pytest.mark.slow
def test_the_tables_agree_with_the_run_folders(copied: tuple[Study, Path]) -> None:
    study, out = copied
    results = read_study(out / "studies/mine")
    scenario = study.scenarios["tiny"]
    tau = scenario.slot_length_s
    for key, config in study.runs():
        folder = config_folder(out, config)
        missions = results.stack(key.policy, "tiny")[key.seed]
        rows = results.table.where(policy=key.policy, seed=key.seed).flights
        assert rows["mission_seed"].tolist() == [10_000, 10_001, 10_002]
        names = (SLOTS, DEVICES, TRAINING, VALIDATION, SAMPLED)
        run = {name: results.curves(name, key.policy, "tiny")[key.seed] for name in names}
        assert run[SLOTS]["x"].tolist() == list(range(1, 13))
        np.testing.assert_allclose(run[SLOTS]["mean_aou_slots"].mean(), missions.mean(), rtol=1e-5)
        np.testing.assert_allclose(run[DEVICES]["communications"].sum(), rows["communications"].mean(), rtol=1e-5)
        meta = json.loads(folder.meta.read_text())
        one = results.trainings(key.policy, "tiny").iloc[key.seed]
        assert (one["slots"], one["agent_steps"]) == (meta["slots"], 2 * meta["slots"])
        np.testing.assert_allclose(
            [one["best_slots"], one["cpu_s"]], [meta["best_score"] / tau, meta["cpu_s"]], rtol=1e-5
        )
        assert meta["cpu_s"] > 0
        with folder.episodes.open(newline="") as file:
            episodes = [float(row["mean_aou_s"]) / tau for row in csv.DictReader(file)]
        assert len(episodes) == 16  # fewer than 200: a group each
        np.testing.assert_allclose(run[TRAINING]["mean_aou_slots"], episodes, rtol=1e-5)
        start = [0] if getattr(config.algorithm, "pull", 0) else []  # is validated too
        assert run[VALIDATION]["x"].tolist() == [*start, 96, 192]
        best = min(run[name]["mean_aou_slots"].min() for name in (VALIDATION, SAMPLED))
        assert best == pytest.approx(one["best_slots"], rel=1e-5)
    bound = results.bounds["tiny"]
    for planner in ("greedy", "anneal"):
        assert (results.stack(planner, "tiny") >= bound * (1 - 1e-5)).all()


def test_a_part_is_the_rows_of_a_policy_on_a_scenario(copied: tuple[Study, Path]) -> None:
    _, out = copied
    table = read_study(out / "studies/mine").table
    pairs = table.flights[["policy", "scenario"]].drop_duplicates().values.tolist()
    for policy, scenario in [*pairs, ("nobody", "tiny")]:
        part, rows = table.part(policy, scenario), table.where(policy=policy, scenario=scenario)
        assert part.flights.equals(rows.flights)
        assert part.curves.equals(rows.curves)


def test_long_curves_are_averaged_in_200_equal_groups(copied: tuple[Study, Path]) -> None:
    folder = run_folder(*copied)
    rows = [f"{k},{10 * k},{k / 2},{-k},{k * 2.0},{k % 7},{3}" for k in range(1, 1001)]
    folder.episodes.write_text("\n".join([folder.episodes.read_text().split("\n")[0], *rows]) + "\n")
    curve = training_curves(folder, Scenario.load("tiny").replace(slot_length_s=4))[0]
    assert len(curve["x"]) == 200
    first = [curve[name][0] for name in ("x", "wall_s", "mean_aou_slots", "communications", "devices_served")]
    assert first == [50, 2.5, 3 * 2 / 4, 3, 3]
    assert (curve["x"][-1], curve["wall_s"][-1]) == (10_000, 500)


def test_a_validation_has_the_time_at_which_it_was_made(finished: tuple[Path, Inline]) -> None:
    results = read_study(finished[0] / "out/studies/mine")
    whole = results.trainings("mappo", "tiny")["wall_s"].tolist()
    for validations, wall_s in zip(results.curves(VALIDATION, "mappo", "tiny"), whole, strict=True):
        assert (np.diff(validations["wall_s"]) >= 0).all()
        assert 0 <= validations["wall_s"][0] < validations["wall_s"][-1] <= wall_s + 0.1  # it is written in tenths


# -- the best ------------------------------------------------------------------------------------------


def test_the_best_by_validation_is_kept_and_can_be_played(copied: tuple[Study, Path]) -> None:
    _, out = copied
    results = read_study(out / "studies/mine")
    for variant in ("mappo", "own critic"):
        trainings = results.trainings(variant, "tiny")
        best = trainings.iloc[trainings["best_slots"].argmin()]
        (kept,) = (out / "studies/mine/best/tiny" / variant).iterdir()
        assert kept.name == f"seed-{best['seed']}"
        assert f"mean AoU {best['mean_aou_slots']:.6g} slots" in (kept / "README.md").read_text()
        assert main(["eval", str(kept), "--episodes", "3", "--quiet", "--out", str(out / "x.csv")]) == 0
        with (out / "x.csv").open() as file:
            ages = [float(row["mean_aou_slots"]) for row in csv.DictReader(file)]
        np.testing.assert_allclose(np.mean(ages), best["mean_aou_slots"], rtol=1e-5)


def test_a_better_seed_takes_the_place_of_the_best(copied: tuple[Study, Path]) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    other = 1 - int(kept.name.removeprefix("seed-"))
    set_to(out / "studies/mine", "best_slots", 0.001, policy="mappo", seed=other)
    shutil.copytree(out / "tiny", out / "away")
    shutil.rmtree(out / "tiny")  # without the folder of the better one, the kept policy stays
    update_results(study, out)
    assert [folder.name for folder in (out / "studies/mine/best/tiny/mappo").iterdir()] == [kept.name]
    shutil.copytree(out / "away", out / "tiny")
    update_results(study, out)
    assert [folder.name for folder in (out / "studies/mine/best/tiny/mappo").iterdir()] == [f"seed-{other}"]


def test_training_from_a_kept_configuration_gives_the_same_results(copied: tuple[Study, Path], tmp_path: Path) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/own critic").iterdir()
    again = tmp_path / "again"
    assert main(["train", "--config", str(kept / "config.yaml"), "--seed", "1", "--out", str(again), "--quiet"]) == 0
    ours, theirs = (run_folder(study, place, "own critic", 1) for place in (again, out))
    for name in ("episodes.csv", "progress.csv"):
        assert without_wall(ours.path / name) == without_wall(theirs.path / name) != []


# -- reports and damage --------------------------------------------------------------------------------


@pytest.mark.parametrize("left", ["nothing", "other evaluations"])
def test_a_report_without_run_folders_keeps_all_rows(copied: tuple[Study, Path], left: str) -> None:
    """A fresh clone has the tables alone; ``uavaou eval`` may have replaced a run's evaluation."""
    study, out = copied
    before = tables(out)
    if left == "nothing":
        shutil.rmtree(out / "tiny")
    else:
        for path in out.glob("tiny/*/seed-*/flights.csv.gz"):
            edit(path.parent, lambda table: Flights(table.flights[:1], table.curves))
    update_results(study, out)
    assert tables(out) == before


def test_the_report_prints_every_variant_and_planner(copied: tuple[Study, Path], shell: Shell) -> None:
    study, out = copied
    before = tables(out)
    command = f"study report {out.parent / 'mine.yaml'} --out {out}"
    with one_writer(out / "studies/mine"):  # while it runs, its tables are taken as they stand
        code, _, said = shell(command)
    assert (code, said.count("\n")) == (0, 1)
    assert "is at work on the study: its page is written from the tables as they stand" in said
    assert tables(out).keys() - before.keys() == {"README.md", "marl-eval.json"}
    shown = shell.out(command)
    for name in (*study.variants, *study.planners, "lower bound"):
        assert any(line.startswith(f"{name} ") for line in shown.splitlines())
    after = tables(out)
    assert {name: after[name] for name in before if name != ".lock"} == {
        name: content for name, content in before.items() if name != ".lock"
    }
    missions = {f"mission-{variant}.json" for variant in study.variants}
    assert after.keys() - before.keys() == {"README.md", "marl-eval.json", "replay.html", *missions}


def test_the_report_warns_of_results_below_the_bound(copied: tuple[Study, Path], shell: Shell) -> None:
    _, out = copied
    set_to(out / "studies/mine", "mean_aou_slots", 1e5, policy="bound")
    code, _, said = shell(f"study report {out.parent / 'mine.yaml'} --out {out}")
    assert (code, "uavaou: 'mappo' on 'tiny' has a mean AoU of " in said) == (0, True)
    assert "below the certified bound of 100,000" in said


def test_a_report_names_a_damaged_best_checkpoint_and_goes_on(copied: tuple[Study, Path], shell: Shell) -> None:
    study, out = copied
    (kept,) = (out / "studies/mine/best/tiny/mappo").iterdir()
    seed = int(kept.name.removeprefix("seed-"))
    best = run_folder(study, out, seed=seed).best
    best.write_bytes(best.read_bytes()[:-4] + b"ouch")
    without(out / "studies/mine", policy="mappo", seed=seed)
    code, _, said = shell(f"study report {out.parent / 'mine.yaml'} --out {out}")
    assert (code, said.count("\n")) == (0, 1)
    assert f"left out: mappo on tiny, seed {seed}: {best}: damaged" in said


@pytest.mark.parametrize("command", ["run", "report"])
def test_results_that_cannot_be_written_are_refused_in_one_line(
    command: str, copied: tuple[Study, Path], shell: Shell
) -> None:
    _, out = copied
    shutil.rmtree(out / "studies/mine")
    (out / "studies/mine/study.yaml.partial").mkdir(parents=True)
    said = shell.refused(f"study {command} {out.parent / 'mine.yaml'} --out {out}")
    assert said.count("\n") == 1
    assert f"cannot write '{out / 'studies/mine/study.yaml'}" in said


@pytest.mark.parametrize("there", ["nothing", "a damaged run"])
def test_a_report_without_results_is_refused_and_writes_nothing(
    there: str, write: Write, tmp_path: Path, shell: Shell
) -> None:
    out, path = tmp_path / "out", write(TINY)
    if there == "a damaged run":
        folder = run_folder(Study.load(path), out)
        folder.path.mkdir(parents=True)
        folder.config.write_text("schema: [1\n")
    before = sorted(out.rglob("*"))
    said = shell.refused(f"study report {path} --out {out}").splitlines()
    assert "nothing of study 'mine' has been evaluated" in said[-1]
    if there == "a damaged run":
        assert "left out: mappo on tiny, seed 0" in said[0]
        assert "YAML" in said[0]
    assert len(said) == (2 if there == "a damaged run" else 1)
    assert sorted(out.rglob("*")) == before
