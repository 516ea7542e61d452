"""A study that is killed, stopped, or whose disk fails, wherever it writes, ends with the tables of the untouched one.

CI plays some of the trials; ``make faults`` plays all.
"""

from __future__ import annotations

import csv
import hashlib
import io
from pathlib import Path

import pytest

from tests.faults import Trial, assert_ended_well, ended, play, sites_of
from tests.studies.tiny_study import SET, Inline, run_inline, tables
from uavaou.errors import InputError
from uavaou.studies.study import Study

TINY = f"""
slots: 96
seeds: 1
scenarios: [tiny]
variants: {{mappo: {{set: {{{SET}}}}}}}
planners: [greedy, anneal]
bound: false
planning_seconds: 0.05
episodes: 2
"""


def run(study: Study, out: Path) -> None:
    """The study in this process.

    Raises:
        InputError: a part of it has failed.
    """
    ended = run_inline(study, out, Inline())
    for reason in ended.failed.values():
        raise InputError(reason)


def timeless(out: Path) -> dict[str, object]:
    """The tables without times, and without annealing, which plans as well as it can in its seconds."""
    found: dict[str, object] = {}
    for name, content in tables(out).items():
        if name.endswith(".csv"):
            table = csv.DictReader(io.StringIO(content.decode()))
            rows = [row for row in table if row.get("variant") != "anneal"]
            found[name] = [{key: cell for key, cell in row.items() if key not in ("wall_s", "cpu_s")} for row in rows]
        elif name.endswith(".safetensors"):  # its header states times
            found[name] = hashlib.sha256(content[8 + int.from_bytes(content[:8], "little") :]).hexdigest()
        elif "lock" not in name and not name.endswith("meta.json"):
            found[name] = content
    return found


@pytest.mark.slow
def test_wherever_it_is_stopped_a_study_ends_with_the_same_tables(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    (tmp_path / "mine.yaml").write_text(TINY)
    study = Study.load(tmp_path / "mine.yaml")
    sites = sites_of(lambda: run(study, tmp_path / "out"), tmp_path)
    untouched = timeless(tmp_path / "out")
    assert len(sites) > 15
    assert len(untouched) > 5

    def one(trial: Trial, place: Path) -> None:
        end = ended(lambda: run(study, place / "out"), place, trial)
        service = "meta.json" in trial.site or ".working" in trial.site or "failures" in trial.site
        assert_ended_well(end, trial, silent=service)
        run(study, place / "out")
        assert timeless(place / "out") == untouched

    play(sites, 4, one, tmp_path, request)
