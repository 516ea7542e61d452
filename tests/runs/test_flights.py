"""The flights of a run in its folder: kept, found where they are of its best policy, and damaged ones made again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uavaou.evaluation.flights import DEVICES, PERIODS, SLOTS, Flights
from uavaou.evaluation.flown import flown
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.planners import make_planner
from uavaou.runs.comparison import evaluate
from uavaou.runs.flights import keep_flights, own_flights
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import load_run
from uavaou.scenario import Scenario


def rows(folder: RunFolder, episodes: int, action: str | None = None) -> Flights:
    """The policy of a run in missions of its own scenario."""
    config, policy = folder.read_config(), load_run(folder, action=action)
    evaluation = evaluate(policy, config.scenario, episodes, EVALUATION_SEED)
    who = {"policy": config.algorithm.name, "scenario": config.scenario.name, "seed": config.seed}
    return flown(evaluation, config.scenario, policy, EVALUATION_SEED, **who)


@pytest.mark.parametrize("layout", ["fixed", "resample"])
@pytest.mark.parametrize("episodes", [1, 3])
def test_flights_are_read_as_they_were_written(tmp_path: Path, episodes: int, layout: str) -> None:
    scenario, policy = Scenario.load("tiny").replace(layout=layout), make_planner("greedy")
    played = evaluate(policy, scenario, episodes, 5)
    flown(played, scenario, policy, 5, policy="greedy", scenario="tiny").write(tmp_path)
    read = Flights.read(tmp_path)
    assert read.flights["mission_seed"].tolist() == list(range(5, 5 + episodes))
    assert read.flights["communications"].tolist() == played.values("communications").tolist()
    np.testing.assert_allclose(
        read.flights["mean_aou_slots"], played.values("mean_aou_s") / scenario.slot_length_s, rtol=1e-5
    )
    assert set(read.curves["curve"]) == ({SLOTS, DEVICES, PERIODS} if layout == "fixed" else {SLOTS})
    assert read.where(curve=SLOTS).curves["low"].notna().all() == (episodes > 1)
    assert read.flights["action"].isna().all()  # of trained policies alone


def test_flights_of_more_missions_are_kept(stopped: RunFolder) -> None:
    two, one = rows(stopped, 2), rows(stopped, 1)
    assert keep_flights(stopped, two) == f"wrote {stopped.flights}"
    assert keep_flights(stopped, one) == f"kept {stopped.flights}: it is of more missions"
    stopped.flights.write_bytes(b"{")  # what cannot be read is replaced
    assert keep_flights(stopped, one) == f"wrote {stopped.flights}"
    stopped.flights.unlink()
    stopped.flights.mkdir()
    assert str(stopped.flights) in keep_flights(stopped, two)


def test_a_runs_own_flights_are_of_its_best_policy_and_action(stopped: RunFolder) -> None:
    config = stopped.read_config()
    assert own_flights(stopped, config, 2) is None
    keep_flights(stopped, rows(stopped, 2))
    found = own_flights(stopped, config, 2)
    assert found is not None
    assert found.flights["mission_seed"].tolist() == [EVALUATION_SEED, EVALUATION_SEED + 1]
    assert own_flights(stopped, config, 3) is None
    for action in ("greedy", "sample"):
        keep_flights(stopped, rows(stopped, 2, action))
        chosen = action == load_run(stopped).action
        assert (own_flights(stopped, config, 2) is not None) == chosen
    rows(stopped, 2).with_values(digest="0" * 64).write(stopped.path)  # of an earlier best
    assert own_flights(stopped, config, 2) is None
    stopped.flights.write_bytes(b"{")
    assert own_flights(stopped, config, 2) is None
