"""A rehearsal: common missions, none of them for results; what candidates may know; the best is served."""

import signal
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaou import Family, InputError, RunConfig, Scenario, evaluate, load_run, rehearse, train
from uavaou.evaluation.seeds import EVALUATION_SEEDS, REHEARSAL_SEEDS, VALIDATION_SEEDS, training_seeds
from uavaou.planners.base import Stay
from uavaou.runs import rehearsal
from uavaou.runs.folder import RunFolder
from uavaou.runs.rehearsal import Candidate, Rehearsal
from uavaou_cli.rehearsal import rehearsal_lines

TINY = Scenario.load("tiny")
FAMILY = Family.from_dict({"name": "few", "base": TINY.to_dict(), "uavs": {"low": 1, "high": 3}})


def test_its_missions_are_its_own() -> None:
    others = (EVALUATION_SEEDS, VALIDATION_SEEDS, training_seeds(0))
    assert not any(set(REHEARSAL_SEEDS) & set(seeds) for seeds in others)
    scenario = Scenario.load("quickstart")
    found = rehearse(scenario, seconds=1e-6)  # without any time the rule is served
    assert [candidate.name for candidate in found.candidates] == ["local-greedy-parts"]
    assert {*found.late} == {"best-first", "local-greedy-tuned", "anneal", "any-map"}
    own = evaluate("local-greedy-parts", scenario, len(found.served.ages), REHEARSAL_SEEDS.start)
    np.testing.assert_array_equal(found.served.ages, own.values("mean_aou_s") / scenario.slot_length_s)
    assert len(set(found.served.ages)) > 1
    assert found.is_clear


@pytest.mark.parametrize(
    ("knows", "more"), [("local", set()), ("shared", set()), ("everything", {"best-first", "rolling"})]
)
def test_no_candidate_knows_more_than_it_may(knows: str, more: set[str]) -> None:
    found = rehearse(TINY, 1.0, knows)
    names = {candidate.name for candidate in found.candidates} | set(found.late)
    assert names == {"local-greedy-parts", "local-greedy-tuned", "anneal", "any-map"} | more
    flown = [len(candidate.ages) for candidate in found.candidates]
    assert flown == sorted(flown, reverse=True)  # those that fell behind fly no more
    finalists = [candidate for candidate in found.candidates if len(candidate.ages) == flown[0]]
    assert found.served is min(finalists, key=lambda candidate: candidate.ages.mean())


def test_limits_of_knowledge_and_layouts_limit_the_candidates() -> None:
    with pytest.raises(InputError, match="unknown knows 'shred'; did you mean 'shared'"):
        rehearse(TINY, 1.0, "shred")
    found = rehearse(TINY.replace(layout="resample"), 1.0, "local")
    assert {one.name for one in found.candidates} | set(found.late) == {"local-greedy-parts", "any-map"}


def candidate(name: str, ages: list[float]) -> Candidate:
    flown = evaluate(Stay(), TINY, len(ages))
    for batch in flown.metrics:
        batch.mean_aou_s[:] = np.array(ages) * TINY.slot_length_s
    return Candidate(name, Stay(), flights=[flown])


@pytest.mark.parametrize(
    ("second", "clear"), [([2.0, 3.1, 4.0, 5.2], True), ([0.0, 3.0, 3.0, 5.0], False), ([1.0, 2.0, 3.0, 4.0], False)]
)
def test_a_lead_is_clear_by_the_differences_on_common_missions(second: list[float], clear: bool) -> None:
    first = candidate("best-first", [1.0, 2.0, 3.0, 4.0])
    both = Rehearsal(TINY, (first, candidate("greedy", second)), ())
    assert both.is_clear == clear
    told = " ".join(rehearsal_lines(both))
    assert ("Its lead is clear." in told, "Its lead is not clear." in told) == (clear, not clear)
    assert "It was compared with no other." in " ".join(rehearsal_lines(Rehearsal(TINY, (first,), ())))


def test_one_that_is_behind_flies_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "AT_ONCE", ("local-greedy-parts", "stay"))
    monkeypatch.setattr(rehearsal, "_AHEAD", {})
    monkeypatch.setattr(rehearsal, "released_names", list)
    found = rehearse(TINY.replace(slots=100), 5.0)
    assert [(one.name, len(one.ages)) for one in found.candidates] == [("local-greedy-parts", 4), ("stay", 4)]
    assert found.is_clear


@pytest.mark.slow
def test_with_time_enough_it_trains_from_the_numbers_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "_TRAINS_FROM_S", 1.0)
    monkeypatch.setattr(rehearsal, "released_names", list)
    shown: list[Any] = []
    began = time.monotonic()
    found = rehearse(TINY, 8.0, folder=tmp_path / "training", on_progress=lambda *given: shown.append(given))
    assert time.monotonic() - began < 16
    (trained,) = (one for one in found.candidates if one.run is not None)
    assert trained.name == str(tmp_path / "training")
    assert (tmp_path / "training" / "plan.json").is_file()
    assert {"local-greedy-tuned", "training"} <= {at_work for _, at_work, _ in shown}
    assert all(0 <= share <= 1 for share, _, _ in shown)
    assert trained.knows == load_run(tmp_path / "training").knows == "local"
    described = found.to_dict()
    assert described["served_run"] == (trained.name if found.served is trained else None)


def test_ctrl_c_in_its_training_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "_TRAINS_FROM_S", 1.0)
    monkeypatch.setattr(rehearsal, "released_names", list)
    monkeypatch.setattr("uavaou.runs.train.train", lambda *_, **__: SimpleNamespace(stopped_by=signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        rehearse(TINY, 1.0, folder=tmp_path / "training")


@pytest.mark.slow
def test_a_policy_of_mixed_observations_flies_by_what_it_may_know(tmp_path: Path) -> None:
    sizes = {"missions": 4, "worlds": 2, "rollout_slots": 6, "batch_rows": 24, "hidden": [8], "evaluation_missions": 4}
    settings = {"observation": "mixed", "reward": "relative", "network": "set", "pull": 5, "collection": "auto"}
    config = RunConfig.load("mappo", TINY, slots=96, plan_slots=0, **sizes, **settings)
    config = RunConfig(TINY, config.algorithm, 0, FAMILY)
    train(config, RunFolder(tmp_path))
    assert load_run(tmp_path, TINY).knows == "shared"
    assert load_run(tmp_path, TINY, knows="local").knows == "local"
    one, other = (evaluate(load_run(tmp_path, TINY, knows=knows), TINY, 2) for knows in ("local", "shared"))
    assert (one.violations, other.violations) == (dict.fromkeys(one.violations, 0),) * 2
    with pytest.raises(InputError, match="alternates between draws of a family"):
        train(RunConfig(TINY, config.algorithm), RunFolder(tmp_path / "one"))
    assert not (tmp_path / "one").exists()
