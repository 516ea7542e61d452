"""The page of a study: a table of every scenario, a reference to hold the others against, the paper's claims."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from synthetic_study import MAPPO, VDN, write_study

from uavaou import InputError
from uavaou.experiments.study import Study
from uavaou.experiments.study_results import read_study, rows_of
from uavaou.experiments.study_tables import by_run
from uavaou.reports.claims_table import BEGIN
from uavaou.reports.standings import standings
from uavaou.reports.study_report import write_report


def study_with(folder: Path, **fields: Any) -> Path:
    write_study(folder)
    content = yaml.safe_load((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(yaml.safe_dump(content | fields, sort_keys=False))
    return folder


def page(folder: Path) -> str:
    write_report(folder, folder.parent / "README.md")
    return (folder / "README.md").read_text()


def test_every_policy_stands_in_the_table_with_its_mean_the_best_first(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "paper")
    rows = [line.split(" | ") for line in page(folder).splitlines() if line.startswith(("| `", "| lower"))]
    assert [row[0].strip("| `") for row in rows] == [
        "lower bound", "mappo", "best-first", "greedy", "vdn", "qmix", "random",
    ]  # fmt: skip
    missions = read_study(folder).missions
    for row in rows[1:]:
        mean = rows_of(missions, variant=row[0].strip("| `"))["mean_aou_slots"].mean()
        assert float(row[2].split()[0].replace(",", "")) == pytest.approx(mean, rel=1e-3)
    assert json.loads((folder / "marl-eval.json").read_text())
    assert not (tmp_path / "README.md").exists()


def test_a_reference_and_claims_are_told_where_the_study_asks_for_them(tmp_path: Path) -> None:
    plain = page(study_with(tmp_path / "plain"))
    assert "Against" not in plain
    assert "claims" not in plain
    text = page(study_with(tmp_path / "asked", reference="vdn", claims=True))
    assert "## Against `vdn`" in text
    assert "better with mappo" in text
    assert "## The paper's claims" in text
    assert BEGIN in (tmp_path / "README.md").read_text()


def test_a_study_that_is_not_finished_has_a_page(tmp_path: Path) -> None:
    """A scenario without the reference, a variant with one seed, a name that would end a cell, no bound."""
    folder = write_study(tmp_path / "own 1", {"published": MAPPO, "a|b": VDN}, {}, 2, ("paper", "b"), bound=None)
    content = yaml.safe_load((folder / "study.yaml").read_text())
    (folder / "study.yaml").write_text(yaml.safe_dump(content | {"reference": "published"}))
    runs = (folder / "runs.csv").read_text().splitlines(keepends=True)
    (folder / "runs.csv").write_text("".join(row for row in runs if "published,published,b," not in row))
    text = page(folder)
    assert "uavaou study run 'own 1.yaml'" in text
    compared = text.partition("## Against `published`")[2]
    assert "| a\\|b | 2 |" in compared
    assert "###" not in compared  # one scenario has both
    table = text.partition("## b\n")[2].partition("##")[0]
    assert "`a\\|b`" in table
    assert "published" not in table


def test_one_seed_and_planners_have_intervals_over_missions(tmp_path: Path) -> None:
    results = read_study(write_study(tmp_path / "one", seeds=1, missions=9))
    found = {one.policy: one for one in standings(results, by_run(results))["paper"]}
    for name in ("mappo", "greedy"):
        scores = rows_of(results.missions, variant=name)["mean_aou_slots"]
        assert found[name].mean.value == pytest.approx(scores.mean())
        spread = scores.std() / 3
        assert found[name].mean.high - found[name].mean.low == pytest.approx(2 * 1.96 * spread, rel=0.15)
    assert (found["mappo"].seeds, found["greedy"].seeds) == (1, 0)
    assert found["mappo"].wall_s == pytest.approx(60)
    assert found["lower bound"].scores.tolist() == [[25.0]]


def test_a_reference_must_be_a_variant(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {}, vdn: {}}\nreference: mapo\n")
    with pytest.raises(InputError, match=r"reference: no variant 'mapo'.*mappo.*\(variants: mappo, vdn\)"):
        Study.load(path)
    path.write_text("seeds: 1\nscenarios: [tiny]\nvariants: {mappo: {}, vdn: {}}\nreference: vdn\n")
    assert Study.load(path).to_dict()["reference"] == "vdn"


def test_what_cannot_be_written_is_told(tmp_path: Path) -> None:
    folder = study_with(tmp_path / "paper")
    (folder / "README.md").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_report(folder, tmp_path / "README.md")
