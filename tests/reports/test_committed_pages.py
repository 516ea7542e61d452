"""The committed pages of the studies come out of the committed tables unchanged."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from uavaou import load_run
from uavaou.evaluation.recorded_mission import read_mission, record_mission
from uavaou.reports.markdown import END
from uavaou.reports.study_report import begin_marker, write_report

RESULTS = Path(__file__).resolve().parents[2] / "results"
STUDIES = sorted(path.parent for path in RESULTS.glob("studies/*/study.yaml"))


def test_the_studies_that_the_pages_tell_of_are_committed() -> None:
    assert {folder.name for folder in STUDIES} >= {"paper", "default"}


@pytest.mark.parametrize("folder", STUDIES, ids=lambda folder: folder.name)
def test_the_committed_pages_come_out_of_the_committed_tables(tmp_path: Path, folder: Path) -> None:
    copy, claims = tmp_path / folder.name, tmp_path / "README.md"
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("figures", "best", "configs", "README.md"))
    assert write_report(copy, claims) == []
    assert (copy / "README.md").read_text(encoding="utf-8") == (folder / "README.md").read_text(encoding="utf-8")
    assert claims.exists() == (folder.name == "paper")
    if claims.exists():
        page = (RESULTS / "README.md").read_text(encoding="utf-8")
        found = re.search(re.escape(begin_marker("paper")) + ".*" + re.escape(END), page, re.DOTALL)
        assert found is not None
        assert found[0] in claims.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", [path for folder in STUDIES for path in folder.glob("mission-*.json")], ids=str)
def test_a_kept_policy_flies_the_mission_that_was_recorded(path: Path) -> None:
    mission = read_mission(path)
    (kept,) = (path.parent / "best" / "paper" / mission.policy).iterdir()
    flown = record_mission(mission.scenario, load_run(kept), mission.mission_seed)
    np.testing.assert_array_equal(flown.collected_by, mission.recording.collected_by)
