"""The verdicts of the page of results follow from the tables."""

from math import nan
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmarks import answers
from uavaou.statistics import Interval


@pytest.mark.parametrize(
    ("ratio", "told"),
    [
        ((0.4, 0.3, 0.5), "MAPPO beats VDN: 0.400 (0.300–0.500)"),
        ((1.2, 1.1, 1.3), "MAPPO is behind VDN: 1.20 (1.10–1.30)"),
        ((0.9, 0.8, 1.1), "no lead over VDN is shown: 0.900 (0.800–1.10)"),
        ((0.9, nan, nan), "no lead over VDN is shown: 0.900"),
    ],
)
def test_mappo_beats_another_where_the_whole_interval_is_below_one(
    ratio: tuple[float, float, float], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answers, "ages", lambda name, variant: np.ones(2 if name == "paper" else 0))
    monkeypatch.setattr(answers, "ratio", lambda name, other: Interval(*ratio))
    line = answers.beaten()
    assert f"From nothing, {told}; " in line
    assert "From a plan, this is not measured yet." in line


def test_what_is_known_of_a_map_is_the_highest_bound_and_the_lowest_age(monkeypatch: pytest.MonkeyPatch) -> None:
    """A study with a later bound, a better plan and a policy for layout 3 changes that row alone."""
    scenarios = {"layout 3": {"layout_seed": 3}}
    worse = SimpleNamespace(scenarios=scenarios, bounds={}, planners=(), stack=lambda *_: np.array([[1e6]]))
    monkeypatch.setattr(answers, "study", lambda name: worse)
    before = answers.reached()
    flown = {
        "rolling": np.array([[60.0]]),
        "random": np.array([[1.0]]),
        "mappo": np.array([[50.0, 54.0], [58.0, 62.0]]),
    }
    study = SimpleNamespace(
        scenarios=scenarios,
        bounds={"layout 3": 40.0},
        planners=("rolling", "random"),
        stack=lambda policy, scenario: flown[policy],
    )
    monkeypatch.setattr(answers, "study", lambda name: study)
    after = answers.reached()
    row = after.loc["paper+layout_seed=3"]
    assert row[["bound", "best", "planner", "mappo", "known"]].tolist() == [40.0, 60.0, "rolling", 56.0, 56.0]
    others = [name for name in before.index if name not in ("paper+layout_seed=0", row.name)]
    columns = ["bound", "best", "planner"]
    pd.testing.assert_frame_equal(after.loc[others, columns], before.loc[others, columns])
