"""A study that is killed, stopped, or whose disk fails, wherever it writes, ends with the tables of the untouched one.

CI plays some of the trials; ``make faults`` plays all.
"""

import hashlib
from pathlib import Path

import pytest

from tests.experiments.small import SET, Inline, run_inline, tables
from tests.faults import Trial, assert_ended_well, ended, play, sites_of
from uavaou import InputError
from uavaou.evaluation.flights import Flights
from uavaou.experiments.study import Study

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
        if name.endswith(".safetensors"):  # its header states times
            found[name] = hashlib.sha256(content[8 + int.from_bytes(content[:8], "little") :]).hexdigest()
        elif "lock" not in name and not name.endswith(("meta.json", ".csv.gz", ".state.json")):
            found[name] = content
    held = Flights.read(out / "studies" / "mine")
    for name, frame in (("flights", held.flights), ("curves", held.curves)):
        rows = frame[frame["policy"] != "anneal"].drop(columns=["wall_s", "cpu_s"], errors="ignore")
        found[name] = rows.to_csv(index=False)
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
        service = "meta.json" in trial.site or ".state" in trial.site
        assert_ended_well(end, trial, silent=service)
        run(study, place / "out")
        assert timeless(place / "out") == untouched

    play(sites, 4, one, tmp_path, request)
