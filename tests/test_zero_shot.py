"""The committed page, model card and numbers of released policies come out of the committed tables."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks.zero_shot import CARD, TABLES, told, write_pages
from uavaou import read_study
from uavaou.reports.suites import read_suite
from uavaou.runs.released import released_folder
from uavaou.suites.suite import Suite

ROOT = Path(__file__).resolve().parents[1]
SUITES = ROOT / "results" / "suites"
POLICIES = sorted(path.parent.name for path in SUITES.glob("*/README.md"))


def test_any_map_is_measured_on_every_suite_of_the_command() -> None:
    assert "any-map" in POLICIES
    assert {path.stem for path in SUITES.glob("any-map/*.csv")} == TABLES.keys()
    for options in TABLES.values():
        assert Suite.load(options[options.index("--suite") + 1]).points


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
    text = (SUITES / "layouts.csv").read_text(encoding="utf-8")
    named = text.replace(",mappo,", ",mappo+layout=resample,").replace(",yes,local\n", ",yes,shared\n")
    (tmp_path / "layouts.csv").write_text(named, encoding="utf-8")
    found = read_suite(tmp_path / "layouts.csv")
    assert told(found, "mappo+layout=resample") == "`mappo+layout=resample` (shared)"
    assert told(found, "best-first") == "`best-first` (everything)"


def test_what_flies_on_layout_0_is_what_flew_in_the_study_of_the_paper() -> None:
    study = read_study(ROOT / "results" / "studies" / "paper")
    same = [row for row in read_suite(SUITES / "known-layouts.csv").rows if row.point == "0" and row.policy != "mappo"]
    assert {row.policy for row in same} == {"anneal", "best-first"}
    for row in same:
        values = study.table("missions", row.policy, "paper", int(row.seed) if row.seed else None)
        assert row.aou.value == pytest.approx(values["mean_aou_slots"].mean(), rel=1e-5)
