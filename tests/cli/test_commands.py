"""What a person types, and what the commands write and print, from training to figures."""

import json
import re
import shlex
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import TINY, TRAIN, Shell, contents, runs
from tests.synthetic_study import record
from uavaou import InputError, Scenario, evaluate
from uavaou.csv_tables import read_table
from uavaou.errors import command_line
from uavaou.evaluation.flights import FLIGHTS, Flights
from uavaou.evaluation.seeds import VALIDATION_SEED
from uavaou_cli import plan, train
from uavaou_cli.options import trained
from uavaou_cli.overrides import parse_overrides
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


def test_an_evaluation_fits_a_terminal_and_says_first_what_one_should_know(shell: Shell) -> None:
    out = shell.done("eval --policy stay --policy random --episodes 3 --quiet")
    assert out.startswith("paper: 3 missions, seeds 10000 to 10002")
    assert all(len(line) <= WIDTH for line in out.splitlines())
    assert "violations" not in out
    assert "broke" not in out
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
    knows = {line.split()[0]: line.split()[1] for line in out.splitlines()[5:] if " " in line}
    assert (knows["random"], knows["local-greedy"], knows["rolling"]) == ("nothing", "local", "everything")
    assert all(len(line) <= WIDTH for line in out.splitlines())


def test_a_training_is_shown_beside_planners_on_its_validation_missions(shell: Shell, workplace: Path) -> None:
    out = shell.done(f"{TINY.replace('--slots 96', '--slots 10')} --algorithm mappo-paper --out short")
    words = " ".join(out.split())
    assert "more than the 10 slots asked for: mappo learns from whole rollouts, here 96 slots of 8 missions" in words
    names = "best-first", "local-greedy-parts"
    reached = [f"{name} {evaluate(name, 'tiny', 4, VALIDATION_SEED).mean_aou_slots:.2f}" for name in names]
    assert f"planners: {reached[0]}, {reached[1]} slots, on the same 4 missions" in words
    assert "above best-first and local-greedy-parts: train longer (--slots 3000000, the default), or begin" in words
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


@pytest.mark.parametrize("text", ["96", "9.6e1", "0.096k", "0_96"])
def test_a_budget_may_be_typed_in_short(shell: Shell, workplace: Path, text: str) -> None:
    (workplace / "results" / "tiny").mkdir(parents=True)
    (workplace / "results" / "tiny" / "vdn+slots=96").write_text("in the way")
    err = shell.refused(f"train tiny --slots {text} --algorithm VDN")
    assert "results/tiny/vdn+slots=96" in err


@pytest.mark.parametrize("text", ["many", "1.5", "1G", "k", "", "1e400", "nan"])
def test_another_budget_is_refused(shell: Shell, workplace: Path, text: str) -> None:
    for command in ("train tiny", "tune tiny"):
        err = shell.refused(shlex.join([*command.split(), "--slots", text]))
        assert err.startswith("uavaou: --slots ")
        assert "whole number, such as 200000, 200k or 1e6" in err or "at most 1,000,000,000,000" in err


def test_commands_are_quoted_only_where_a_shell_needs_it() -> None:
    words = ["uavaou", "eval", "results/valley~1a2b/mappo+slots=60000/seed-0", "~x", "layout 1", ""]
    line = command_line(words)
    assert line == "uavaou eval results/valley~1a2b/mappo+slots=60000/seed-0 '~x' 'layout 1' ''"
    assert shlex.split(line) == words


def test_a_folder_above_runs_says_which_they_are(shell: Shell, workplace: Path) -> None:
    for seed in range(7):
        run = workplace / "r" / "mappo" / f"seed-{seed}"
        run.mkdir(parents=True)
        (run / "config.yaml").write_text("")
    code, _, err = shell("eval r")
    assert code == 2
    assert "'r' is not a run folder" in err
    assert "runs below it: r/mappo/seed-0, r/mappo/seed-1, " in err
    assert err.endswith(" and 2 more\n")


def test_overrides_reach_into_ranges_and_leave_the_rest() -> None:
    items = ["scenario.bandwidth_hz.low=14e3", "scenario.layout_seed=7", "algorithm.learning_rate=1e-4"]
    overrides = parse_overrides(items)
    base = Scenario.load("quickstart")
    changed = overrides.of_scenario(base).to_dict()
    assert changed == base.to_dict() | {"bandwidth_hz": {"low": 14e3, "high": 2e4}, "layout_seed": 7}
    assert overrides.of_algorithm("ippo").model_dump()["learning_rate"] == 1e-4


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell) -> Path:
    """A folder with two trainings, of which one changed more than a name can say."""
    monkeypatch.chdir(tmp_path)
    more = " --set algorithm.gamma=0.9 --set algorithm.clip_range=0.3 --set algorithm.max_gradient_norm=9"
    for settings in ("", more):
        line = "train tiny --algorithm ippo --slots 60 --set algorithm.missions=2 --set algorithm.hidden=[8] --quiet"
        assert shell(line + settings)[0] == 0
    return tmp_path


def test_they_are_listed_with_what_each_changed_and_reached(place: Path, shell: Shell) -> None:
    (other,) = (path.name for path in (place / "results/tiny").glob("ippo+*") if "=" not in path.name)
    (place / "results/tiny" / other / "seed-0/meta.json").unlink()
    damaged = place / "results/tiny/vdn/seed-0/config.yaml"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("schema: 1\n")
    out = shell.done("runs")
    lines = out.splitlines()
    assert lines[0].split() == ["run", "slots", "mean", "AoU", "state"]
    found = {line.split()[0]: line.split()[1:] for line in lines[1:] if line.startswith("results")}
    first = found["results/tiny/ippo+hidden=%5B8%5D,missions=2,slots=60/seed-0"]
    assert (first[0], first[2]) == ("120", "finished")  # a whole rollout
    assert float(first[1]) > 0
    assert found[f"results/tiny/{other}/seed-0"] == ["begun"]
    assert found["results/tiny/vdn/seed-0"] == ["damaged"]
    changed = "slots=60, missions=2, hidden=[8], gamma=0.9, clip_range=0.3, max_gradient_norm=9.0"
    assert changed in " ".join(out.split())
    assert "vdn/seed-0/config.yaml" in out


def test_their_names_are_completed(place: Path) -> None:
    assert "any-map" in trained("")
    found = trained("results/tiny/ippo")
    assert len(found) == 2
    assert all((place / name / "config.yaml").is_file() for name in found)
    assert trained("nothing") == []


def names(page: Path) -> list[str]:
    """The policies whose flights a page holds."""
    return re.findall(r'"name":"([^"]*)","cells"', page.read_text(encoding="utf-8"))


def test_it_writes_a_page_and_prints_the_figures(shell: Shell, workplace: Path) -> None:
    out = shell.done("replay greedy best-first --scenario tiny --set scenario.layout_seed=2 --quiet")
    page = Path("results/tiny+layout_seed=2/replay/greedy,best-first/mission-10000.html")
    assert out.splitlines()[-1] == str(page)
    assert out.startswith("tiny with layout_seed=2: 1 mission, seed 10000")
    assert names(page) == ["greedy", "best-first"]


def test_recorded_missions_stand_beside_flown_ones(shell: Shell, workplace: Path) -> None:
    for policy in ("mappo", "vdn"):
        record(workplace, policy)  # on tiny, seed 5
    code, out, _ = shell("replay mission-vdn.json stay ./mission-mappo.json --out x.html --quiet")
    assert (code, "tiny: 1 mission, seed 5" in out) == (0, True)
    assert names(Path("x.html")) == ["VDN, seed 0", "stay", "MAPPO, seed 0"]
    assert shell("replay mission-vdn.json --out y.html") == (0, "y.html\n", "")
    for command, reason in (
        ("replay mission-vdn.json stay --seed 6", "they differ in mission_seed"),
        ("replay mission-vdn.json stay --scenario quickstart", "they differ in scenario"),
    ):
        code, _, err = shell(f"{command} --out z.html --quiet")
        assert (code, reason in err, err.count("\n")) == (2, True, 1)
        assert not Path("z.html").exists()


@pytest.mark.slow
def test_it_takes_runs_and_writes_films(
    shell: Shell, trained: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = runs(trained)["run"]
    out = shell.done(f"replay {run} stay --seed 7 --out {tmp_path}/x.html --quiet")
    assert names(tmp_path / "x.html") == ["mappo-paper, seed 0", "stay"]
    monkeypatch.setattr("uavaou_cli.progress._LINE_EVERY_S", 0)
    code, out, err = shell(f"replay stay --scenario tiny --out {tmp_path}/x.gif")
    assert (code, out.splitlines()[-1]) == (0, f"{tmp_path}/x.gif")
    assert "gif: " in err
    assert (tmp_path / "x.gif").read_bytes().startswith(b"GIF89a")


def test_mp4_names_the_extra_that_it_needs(shell: Shell, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    err = shell.refused("replay stay --scenario tiny --format mp4")
    assert "--format mp4: 'av' is not installed: pip install 'uavaou[video]'" in err
    assert not (workplace / "results").exists()
