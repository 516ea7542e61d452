"""The way from training to figures: what the commands write and print."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import TINY, TRAIN, Shell, contents, runs
from uavaou import InputError, Scenario, evaluate
from uavaou.csv_tables import read_table
from uavaou.evaluation.flights import FLIGHTS, Flights
from uavaou.evaluation.seeds import VALIDATION_SEED
from uavaou_cli import plan, train
from uavaou_cli.tables import WIDTH


def test_planners_meet_the_same_missions_whatever_stands_beside_them(shell: Shell, workplace: Path) -> None:
    base = "eval --scenario quickstart --set scenario.layout_seed=3 --episodes 5 --seed 7 --out"
    for command in (f"{base} both.csv --policy stay --policy random", f"{base} deep/one.csv --policy random"):
        code, _, err = shell(command)
        assert (code, err.startswith("wrote ")) == (0, True)
    both, one = (read_table(workplace / name, FLIGHTS) for name in ("both.csv", "deep/one.csv"))
    random = both[both["policy"] == "random"].reset_index(drop=True)
    assert random.equals(one)
    assert set(both["scenario"]) == {"quickstart"}
    assert one["mission_seed"].tolist() == [7, 8, 9, 10, 11]
    assert list(both["policy"].unique()) == ["stay", "random"]
    played = evaluate("random", Scenario.load("quickstart").replace(layout_seed=3), 5, seed=7)
    tau = played.slot_length_s
    np.testing.assert_allclose(one["mean_aou_slots"], played.values("mean_aou_s") / tau, rtol=1e-5)


def test_progress_goes_to_stderr_unless_quiet(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaou_cli.progress._LINE_EVERY_S", 0)
    command = "eval --scenario tiny --policy stay --policy random --episodes 2"
    _, out, err = shell(command)
    lines = err.splitlines()
    assert len(lines) == 2 * 11  # a line a slot
    assert lines[-1].startswith("100%  random: ")
    assert all("slots/s, mean AoU so far" in line and "s left" in line for line in lines)
    assert shell(f"{command} --quiet") == (0, out, "")


def test_the_table_of_the_default_scenario_fits_a_terminal(shell: Shell) -> None:
    out = shell.done("eval --policy stay --policy random --episodes 3 --quiet")
    assert out.startswith("paper: 3 missions, seeds 10000 to 10002")
    assert all(len(line) <= WIDTH for line in out.splitlines())
    assert "violations" not in out
    assert "broke" not in out


def test_what_one_should_know_first_stands_above_the_table(shell: Shell) -> None:
    command = "eval --scenario tiny --policy stay --episodes 1 --quiet --set scenario.transmit_power_mw=0.001"
    out = shell.done(command)
    title, remark, table, _ = out.split("\n\n")
    assert title.startswith("tiny with transmit_power_mw=0.001")
    assert remark == "No device can be collected from anywhere: uavaou audit SCENARIO says why."
    assert "stay" in table
    code, out, _ = shell("gap tiny --episodes 1 --time-limit 0.1 --quiet --set scenario.transmit_power_mw=0.001")
    assert (code, out.split("\n\n")[1]) == (0, remark)


def test_an_action_has_two_names_and_an_evaluation_elsewhere_leaves_the_run_alone(shell: Shell, trained: Path) -> None:
    run, before, shown = runs(trained)["run"], contents(trained), {}
    for word in ("likeliest", "greedy", "sampled", "sample"):
        shown[word] = shell.done(f"eval {run} --scenario tiny --episodes 2 --quiet --action {word}")
    assert "sample" in shell.done(f"eval {run} --set scenario.layout_seed=5 --episodes 2 --action sample")
    assert contents(trained) == before
    assert (shown["greedy"], shown["sample"]) == (shown["likeliest"], shown["sampled"])
    assert "likeliest" in shown["greedy"]
    assert "greedy" not in shown["greedy"]
    assert "sampled" in shown["sample"]
    assert "did you mean 'likeliest'?" in shell.refused(f"eval {run} --action likelyest")


def test_a_plan_is_saved_flown_and_drawn(shell: Shell, workplace: Path) -> None:
    code, out, err = shell("plan tiny --planner exact --episodes 1")
    assert code == 0
    assert "proven optimal" in out
    assert "gap 0.0%" in err
    assert all(len(line) <= WIDTH for line in out.splitlines())
    folder = workplace / "results" / "tiny" / "plan" / "exact"
    assert {path.suffix for path in folder.iterdir()} == {".json", ".png", ".pdf"}
    assert json.loads((folder / "plan.json").read_text())["planner"] == "exact"
    before = contents(folder)
    err = shell.refused("plan tiny --planner exact --episodes 1")
    assert "'results/tiny/plan/exact' already holds a plan: add --replace" in err
    assert contents(folder) == before


def test_a_plan_never_takes_the_place_of_another(
    shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def keep(*arguments: Any) -> None:
        folder = arguments[-2]
        folder.mkdir(parents=True)
        (folder / "plan.json").write_text("{}")

    monkeypatch.setattr(plan, "_plan_and_report", keep)
    commands = ["plan tiny", "plan tiny --planner tour", "plan tiny --time-limit 5", "plan tiny --set scenario.slots=9"]
    for command in commands:
        assert shell(command)[0] == 0, command
    for slots in (8, 9):  # one file, two contents
        (workplace / "valley.yaml").write_text(f"base: tiny\nslots: {slots}\n")
        assert shell("plan valley.yaml")[0] == 0
    assert len(list(workplace.glob("results/valley*/plan/anneal/plan.json"))) == 2
    for command in [*commands, "plan valley.yaml", "plan tiny --out results/tiny/plan/tour"]:
        assert "already holds a plan" in shell.refused(command), command
    monkeypatch.setattr(plan, "_plan_and_report", lambda *_: None)
    assert shell("plan tiny --replace")[0] == 0


@pytest.mark.parametrize(("limit", "left"), [(1, 0.5), (5, 3.0), (90, 58.0), (60, 28.0)])
def test_a_time_limit_is_that_of_bound_plan_and_flight_together(
    shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch, limit: int, left: float
) -> None:
    clock, given = SimpleNamespace(s=0.0), []

    def bound(*_: Any) -> Any:
        clock.s += 30
        return SimpleNamespace(mean_aou_s=1.0)

    def planner(_: str, limit_s: float) -> Any:
        given.append(limit_s)
        raise InputError("enough")

    monkeypatch.setattr(plan, "time", SimpleNamespace(monotonic=lambda: clock.s))
    monkeypatch.setattr("uavaou.planners.bound.lower_bound", bound)
    monkeypatch.setattr("uavaou.planners.make_planner", planner)
    assert shell(f"plan tiny --time-limit {limit} --quiet") == (2, "", "uavaou: enough\n")
    assert given == [left]


def test_gap_orders_policies_between_bound_and_random(shell: Shell) -> None:
    out = shell.out("gap tiny --episodes 1 --time-limit 0.3 --quiet")
    names = [line.split()[0] for line in out.splitlines()[4:] if line]
    assert names[0] == "lower"
    assert {"exact", "rolling", "greedy", "random"} < set(names)
    knows = {line.split()[0]: line.split()[1] for line in out.splitlines()[5:] if line}
    assert (knows["random"], knows["local-greedy"], knows["rolling"]) == ("nothing", "local", "everything")
    assert all(len(line) <= WIDTH for line in out.splitlines())


def test_a_training_is_shown_beside_planners_on_its_validation_missions(shell: Shell, workplace: Path) -> None:
    out = shell.done(f"{TINY.replace('--slots 96', '--slots 10')} --algorithm mappo-paper --out short")
    words = " ".join(out.split())
    assert "more than the 10 slots asked for: mappo learns from whole rollouts, here 96 slots of 8 missions" in words
    names = "best-first", "local-greedy-parts"
    reached = [f"{name} {evaluate(name, 'tiny', 4, VALIDATION_SEED).mean_aou_slots:.2f}" for name in names]
    assert f"planners: {reached[0]}, {reached[1]} slots, on the same 4 missions" in words
    assert "above best-first and local-greedy-parts: train longer (--slots 3000000, as published), or begin" in words
    assert "(--from any-map)" in words
    assert all(len(line) <= WIDTH for line in out.splitlines() if not line.startswith(("next:", "run folder:")))


def test_a_training_that_is_below_planners_gets_no_advice(
    shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaou.runs.validation.planner_score", lambda name, config: 1e9)
    out = shell.out(f"{TINY} --out below")
    assert "planners:" in out
    assert "above" not in out
    assert "asked for" not in out
    monkeypatch.setattr(train, "_MOST_WORK", 1)  # planners that would take minutes are left out
    out = shell.out(f"{TINY} --out large")
    assert "planners:" not in out


def test_a_validation_says_how_little_a_policy_has_learnt(shell: Shell, workplace: Path) -> None:
    options = "--slots 1000 --set algorithm.missions=4 --set algorithm.evaluate_every_slots=128"
    options += " --set algorithm.evaluation_missions=2 --set algorithm.learning_starts=200"
    code, _, err = shell(f"train tiny --algorithm vdn {options}")
    shown = [line.split(":")[0] for line in err.splitlines() if "validation missions" in line]
    assert (code, shown[0]) == (0, "128 slots (the untrained policy)")
    assert re.fullmatch(r"1,0\d\d slots", shown[-1])
    assert "likeliest actions" in err


def test_a_training_that_can_collect_nothing_says_so_first(shell: Shell, workplace: Path) -> None:
    code, _, err = shell(f"{TINY} --set scenario.transmit_power_mw=0.001")
    assert code == 0
    assert err.startswith("uavaou: warning: no device can be collected from anywhere; uavaou audit")


@pytest.mark.slow
def test_from_training_to_figures(shell: Shell, workplace: Path) -> None:
    out = shell.done(f"{TRAIN} --slots 3000")
    assert "best validation: mean AoU" in out
    following = shlex.split(out.split("next:")[1])
    run = Path(following[2])
    assert f"run folder:      {run}\n" in out
    assert shell("runs")[1].count("slots=3000") == 1

    code, out, err = shell(shlex.join([*following[1:], "--episodes", "6", "--out", "e.csv"]))
    assert code == 0
    assert err.splitlines() == [f"wrote {run / 'flights.csv.gz'}", "wrote e.csv"]
    assert all(len(line) <= WIDTH for line in out.splitlines() if line != str(run))
    table = read_table(workplace / "e.csv", FLIGHTS)
    assert list(table["policy"].unique()) == [str(run), "random", "greedy"]
    assert table["action"].notna().tolist() == (table["policy"] == str(run)).tolist()
    assert all(knows in out for knows in table["knows"].unique())
    assert (table.groupby("policy").size() == 6).all()
    assert set(table["violations"]) == {0}
    kept = Flights.read(run)
    assert list(kept.flights["policy"].unique()) == ["mappo", "random", "greedy"]
    assert kept.flights["mean_aou_slots"].tolist() == table["mean_aou_slots"].tolist()
    assert set(kept.curves.groupby("curve").size()[["slots"]]) == {3 * 60}

    for command, parts in ((f"plot figures {run}", 14), (f"plot trajectories {run} --out pictures", 4)):
        out = shell.done(command)
        assert len(out.splitlines()) == parts
        assert all((workplace / line).stat().st_size > 1000 for line in out.splitlines())
