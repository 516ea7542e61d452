"""The committed page, model card and numbers of released policies come out of the committed tables."""

import shutil
from pathlib import Path

import pytest

from benchmarks.zero_shot import CARD, TABLES, told, write_pages
from tests.experiments.test_suite import rows, written
from uavaou.evaluation.flights import FLIGHTS, Flights, read_table
from uavaou.experiments.suite import Suite
from uavaou.reports.suites import read_suites
from uavaou.runs.released import released_folder

ROOT = Path(__file__).resolve().parents[1]
SUITES = ROOT / "results" / "suites"
POLICIES = sorted(path.parent.name for path in SUITES.glob("*/README.md"))


def test_any_map_is_measured_on_every_suite_of_the_command_as_in_the_study() -> None:
    assert "any-map" in POLICIES
    assert {path.name.removesuffix(".csv.gz") for path in SUITES.glob("any-map/*.csv.gz")} == TABLES.keys()
    for options in TABLES.values():
        assert Suite.load(options[options.index("--suite") + 1]).points
    study = Flights.read(ROOT / "results" / "studies" / "paper").where(scenario="paper").flights
    flown = read_table(SUITES / "any-map" / "known-layouts.csv.gz", FLIGHTS)
    flown = flown[(flown["point"] == "0") & (flown["how"] == "planner")]
    assert set(flown["policy"]) == {"best-first", "local-greedy-parts"}
    for policy, own in flown.groupby("policy"):
        ages = study.loc[study["policy"] == policy, "mean_aou_slots"]
        assert own["mean_aou_slots"].tolist() == ages.tolist()


@pytest.mark.parametrize("policy", POLICIES)
def test_the_committed_page_and_card_come_out_of_the_committed_tables(policy: str, tmp_path: Path) -> None:
    copy, card = tmp_path / "suites", released_folder() / policy / "README.md"
    shutil.copytree(SUITES, copy, ignore=shutil.ignore_patterns("*.png", "*.pdf", "README.md"))
    (tmp_path / "README.md").write_text(CARD.sub(r"\1\2", card.read_text(encoding="utf-8")), encoding="utf-8")
    write_pages(policy, copy, tmp_path / "README.md")
    assert (copy / policy / "README.md").read_text(encoding="utf-8") == (SUITES / policy / "README.md").read_text(
        encoding="utf-8"
    )
    assert (tmp_path / "README.md").read_text(encoding="utf-8") == card.read_text(encoding="utf-8")


def test_a_policy_of_any_name_is_said_to_know_what_its_table_says(tmp_path: Path) -> None:
    learned = rows("mappo+layout=resample", "zero-shot", "101", 101, 9, seed=0, knows="shared")
    planner = rows("best-first", "planner", "101", 101, 8, knows="everything")
    (found,) = read_suites([written(tmp_path / "layouts.csv", learned, planner)])
    assert told(found, "mappo+layout=resample") == "`mappo+layout=resample` (shared)"
    assert told(found, "best-first") == "`best-first` (everything)"
