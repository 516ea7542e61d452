"""``uavaou eval --suite``: what is played, told and written, and what is refused."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.suites.small_suites import GOOD, OWN, call
from uavaou.scenario import Scenario


def test_a_suite_is_played_printed_and_written(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    command = "eval run --policy greedy --suite own.yaml --episodes 3 --quiet --out out/own.csv --json all.json"
    code, out, err = call(capsys, command)
    assert (code, err) == (0, "")
    for words in (
        "off the grid - infeasible -",
        "off the grid: infeasible: scenario 'tiny': cds_m[0] = [50, 0]: x is not on the grid",
        "breaks constraint (CDS)",
        "no time: infeasible: scenario 'tiny': flight_time_budget_s = 1",
        "breaks constraint (Time)",
        "no link: infeasible: no device can be served: R_min = 10000 kbit/s",
        "(constraint Rate)",
        "mappo does not fly other devices: its network takes 2 UAVs and 4 devices; one with network=set takes any",
        "no run of mappo fits other devices; this trains one:",
        "--set scenario.devices=3",
        "constraint violations: none",
    ):
        assert words in " ".join(out.split()), words
    rows = list(csv.DictReader((place / "out" / "own.csv").open()))
    assert [(row["point"], row["policy"], row["trained"], row["seed"]) for row in rows] == [
        ("150", "mappo", "trained", "0"), ("150", "greedy", "planner", ""),
        ("100", "mappo", "zero-shot", "0"), ("100", "greedy", "planner", ""),
        ("other devices", "greedy", "planner", ""),
        ("new layouts", "mappo", "zero-shot", "0"), ("new layouts", "greedy", "planner", ""),
    ]  # fmt: skip
    assert {(row["suite"], row["missions"], row["axis"], row["scale"]) for row in rows} == {
        ("own", "3", "minimum rate (kbit/s)", "linear")
    }
    assert {(row["trained"], row["training_slots"]) for row in rows} == {
        ("trained", "96"), ("zero-shot", "96"), ("planner", "")
    }  # fmt: skip
    assert [row["trained_on"] for row in rows if row["policy"] == "mappo"] == ["tiny"] * 3
    assert {row["trained_on"] for row in rows if row["policy"] == "greedy"} == {""}
    assert "mappo: trained on tiny" in out
    assert "trained with slots" not in out
    own = json.loads((place / "run" / "eval" / "own.json").read_text())
    assert [point["label"] for point in own["points"]] == ["150", "100", "new layouts"]
    assert [point["how"]["mappo"] for point in own["points"]] == ["trained", "zero-shot", "zero-shot"]
    assert set(own["points"][0]["policies"]) == {"mappo", "greedy"}
    assert own["points"][0]["trained_on"] == {"mappo": "tiny"}
    assert own["points"][1]["set"] == {"rate_min_bit_s": 100000}
    whole = json.loads((place / "all.json").read_text())
    assert [set(point["policies"]) for point in whole["points"]][2] == {"greedy"}


def test_policies_are_compared_with_best_first_mission_by_mission(
    capsys: pytest.CaptureFixture[str], place: Path
) -> None:
    command = "eval run --policy best-first --suite own.yaml --episodes 3 --quiet --out own.csv --json all.json"
    code, out, _ = call(capsys, command)
    assert code == 0
    rows = {(row["point"], row["policy"]): row for row in csv.DictReader((place / "own.csv").open())}
    tau = Scenario.load("tiny").slot_length_s
    for point in json.loads((place / "all.json").read_text())["points"]:
        row = rows.get((point["label"], "mappo"))
        if row is None:
            continue
        own, best = (np.array(point["policies"][name]["mean_aou_s"]) / tau for name in ("run", "best-first"))
        assert float(row["ratio"] or "inf") == pytest.approx(
            own.mean() / best.mean() if best.any() else np.inf, rel=1e-5
        )
        assert float(row["difference"]) == pytest.approx(own.mean() - best.mean(), rel=1e-5)
        assert float(row["worst_mission"]) == pytest.approx((own / (2 * best + 5)).max(), rel=1e-5)
        words = f"{point['label']} mappo {own.mean() - best.mean():+.2f} slots {float(row['worst_mission']):.2f}"
        assert words in " ".join(out.split())
    assert "geometric mean" not in out  # best-first has less than 20 slots everywhere
    call(capsys, "eval run --suite own.yaml --episodes 2 --quiet --out own.csv")
    assert {row["ratio"] for row in csv.DictReader((place / "own.csv").open())} == {""}  # best-first did not play


def test_a_point_equals_eval_on_its_scenario(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    assert call(capsys, "eval run --suite own.yaml --episodes 3 --quiet --out own.csv")[0] == 0
    call(capsys, "eval run --set scenario.rate_min_bit_s=100000 --episodes 3 --quiet --json plain.json")
    plain = json.loads((place / "plain.json").read_text())["policies"]["run"]
    point = json.loads((place / "run" / "eval" / "own.json").read_text())["points"][1]["policies"]["mappo"]
    assert point == plain
    row = next(row for row in csv.DictReader((place / "own.csv").open()) if row["point"] == "100")
    slots = np.array(plain["mean_aou_s"]) / Scenario.load("tiny").slot_length_s
    assert float(row["mean_aou_slots"]) == pytest.approx(slots.mean(), rel=1e-5)
    assert float(row["communications"]) == pytest.approx(np.mean(plain["communications"]), rel=1e-5)
    assert float(row["low"]) <= float(row["mean_aou_slots"]) <= float(row["high"])


def test_without_runs_the_missing_trainings_are_printed_and_nothing_is_written(
    capsys: pytest.CaptureFixture[str], place: Path
) -> None:
    before = sorted(place.rglob("*"))
    code, out, _ = call(capsys, "eval --suite devices")
    assert code == 0
    assert "no run of mappo fits 100; this trains one:\n  uavaou train --scenario paper --algorithm mappo" in out
    assert "uavaou study run suite-devices" in out
    assert sorted(place.rglob("*")) == before
    assert max(map(len, call(capsys, "eval --suite own.yaml")[1].splitlines())) < 120


def test_a_planner_that_refuses_a_point_gives_its_reason(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    points = [{"label": "none", "x": 0}] + [
        {"label": label, "x": x, "set": {"fading": "rician", "rician_factor": x}}
        for x, label in enumerate(("Rice", "K = 2"), 1)
    ]
    (place / "faded.yaml").write_text(yaml.safe_dump(GOOD | {"scenario": "tiny", "points": points}))
    code, out, _ = call(capsys, "eval --policy exact --policy stay --suite faded.yaml --episodes 2 --quiet --out o.csv")
    assert code == 0
    (reason,) = (part for part in " ".join(out.split()).split("exact does not fly ")[1:])  # once
    assert reason.startswith("Rice, K = 2: fading = rician: needs a deterministic channel, fading: none")
    played = {(row["point"], row["policy"]): row for row in csv.DictReader((place / "o.csv").open())}
    assert list(played) == [("none", "exact"), ("none", "stay"), ("Rice", "stay"), ("K = 2", "stay")]
    assert float(played["none", "exact"]["mean_aou_slots"]) == pytest.approx(4 / 3, abs=1e-3)  # the proven optimum


def test_changes_of_the_scenario_are_part_of_every_name(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    command = "eval run --suite own.yaml --set scenario.layout_seed=3 --episodes 2 --quiet --out own.csv"
    code, out, _ = call(capsys, command)
    assert code == 0
    assert (place / "run" / "eval" / "own+layout_seed=3.json").is_file()
    assert {row["suite"] for row in csv.DictReader((place / "own.csv").open())} == {"own+layout_seed=3"}
    assert "mappo: trained on tiny" in out


def test_all_runs_fly_and_names_and_lines_tell_them_apart(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    shutil.copytree(place / "run", place / "other")
    config = yaml.safe_load((place / "other" / "config.yaml").read_text())
    config["algorithm"]["slots"], config["scenario"]["rate_min_bit_s"] = 48, 100000.0
    (place / "other" / "config.yaml").write_text(yaml.safe_dump(config))
    code, out, _ = call(capsys, "eval run other --suite own.yaml --episodes 2 --quiet --out own.csv")
    assert code == 0
    for words in (
        "mappo+slots=96: trained with slots = 96",
        "mappo+slots=48: trained with slots = 48",
        "mappo+slots=96: trained on tiny",
        "mappo+slots=48: trained on tiny+rate_min_bit_s=100000.0",
    ):
        assert words in out, words
    played = [
        (row["point"], row["policy"], row["trained"], row["training_slots"], row["trained_on"])
        for row in csv.DictReader((place / "own.csv").open())
    ]
    short, long = ("48", "tiny+rate_min_bit_s=100000.0"), ("96", "tiny")
    assert played == [
        ("150", "mappo+slots=96", "trained", *long),
        ("150", "mappo+slots=48", "zero-shot", *short),
        ("100", "mappo+slots=96", "zero-shot", *long),
        ("100", "mappo+slots=48", "trained", *short),
        ("new layouts", "mappo+slots=96", "zero-shot", *long),
        ("new layouts", "mappo+slots=48", "zero-shot", *short),
    ]
    assert call(capsys, "plot suite own.csv --out .")[0] == 0


def test_an_evaluation_of_more_missions_is_kept(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    assert call(capsys, "eval run --suite own.yaml --episodes 4 --quiet")[0] == 0
    kept = (place / "run" / "eval" / "own.json").read_bytes()
    assert "kept run/eval/own.json" in call(capsys, "eval run --suite own.yaml --episodes 2")[2]
    assert (place / "run" / "eval" / "own.json").read_bytes() == kept


def test_a_damaged_run_is_found_before_anything_is_played(capsys: pytest.CaptureFixture[str], place: Path) -> None:
    best = place / "run" / "checkpoints" / "best.safetensors"
    best.write_bytes(best.read_bytes()[:-40])
    code, out, err = call(capsys, "eval run --policy greedy --suite own.yaml --out own.csv --episodes 2")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert not (place / "own.csv").exists()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("eval run --suite obsrvation", "did you mean 'observation'"),
        ("eval run --suite nowhere.yaml", "suite file 'nowhere.yaml' does not exist"),
        ("eval run --suite fadin.yaml", "suite file 'fadin.yaml' does not exist; did you mean 'fading'?"),
        ("eval run --suite own", "observation, paper, rate, uavs, unseen-layouts; or a path ending in .yaml)"),
        ("eval run --suite empty.yaml", "empty.yaml: expected a mapping of field names to values, found nothing"),
        ("eval run --suite misspelt.yaml", "misspelt.yaml: unknown field 'ponits'; did you mean 'points'?"),
        ("eval nowhere --suite fading", "run folder 'nowhere' does not exist"),
        ("eval begun --suite own.yaml", "'begun' holds no checkpoint yet"),
        (
            "eval run --suite rate --set scenario.rate_min_bit_s=3",
            "cannot be changed: the points of the suite 'rate' set it",
        ),
        ("eval run --suite own.yaml --out a.csv --json ./a.csv", "--out and --json are both 'a.csv'"),
        ("eval run --suite fading --set algorithm.gamma=1", "only scenario.* can be set"),
        ("eval run --out x.csv", "--out writes the table of a --suite"),
        ("eval run --suite fading --out .", "is a folder"),
        ("eval run --suite fading --time-limit 5", "needs a --policy that plans ahead"),
        ("eval run --suite fading --policy anneal --time-limit nan", "must be a positive number"),
        ("plot suite", "no FILE"),
        ("plot suite own.yaml", "column 'suite' is missing"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], place: Path, command: str, words: str
) -> None:
    (place / "empty.yaml").touch()
    (place / "misspelt.yaml").write_text(OWN.replace("points", "ponits"))
    shutil.copytree(place / "run", place / "begun", ignore=shutil.ignore_patterns("*.safetensors"))
    before = sorted(place.rglob("*"))
    code, out, err = call(capsys, command)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert sorted(place.rglob("*")) == before
