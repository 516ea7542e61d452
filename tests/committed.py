"""The studies whose tables are in the repository, each read once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from uavaou.studies.results import StudyResults, read_study

STUDIES = Path(__file__).resolve().parents[1] / "results" / "studies"


@cache
def study(name: str) -> StudyResults:
    return read_study(STUDIES / name)
