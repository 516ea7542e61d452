"""The page of a study: a table of every scenario, a reference to hold the others against, the paper's claims."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from synthetic_study import write_study

from uavaou import InputError
from uavaou.experiments.study import Study
from uavaou.experiments.study_results import read_study, rows_of
from uavaou.reports.claims_table import BEGIN
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
        assert float(row[2].split()[0]) == pytest.approx(mean, rel=1e-3)
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
