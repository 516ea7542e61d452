"""``uavs`` changed alone: altitudes and CDSs follow a rule."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.scenario_files import refusal, write
from uavaou import Scenario
from uavaou.fleet import spread_altitudes
from uavaou_cli.overrides import parse_overrides

PAPER = Scenario.load("paper")


def test_the_number_of_uavs_can_change_alone(tmp_path: Path) -> None:
    more = PAPER.replace(uavs=5)
    assert more.altitudes_m == (80, 90, 100, 85, 95)
    assert more.cds_m == ((0, 0), (1000, 0), (0, 1000), (0, 0), (1000, 0))
    assert PAPER.replace(uavs=2) == PAPER.replace(uavs=2, altitudes_m=[80, 90], cds_m=[[0, 0], [1000, 0]])
    assert parse_overrides(["scenario.uavs=5"]).of_scenario(PAPER) == more
    assert Scenario.load(write(tmp_path, "base: paper\nname: paper\nuavs: 5\n")) == more
    assert PAPER.replace(uavs=3) == PAPER
    assert PAPER.replace(devices=40).devices == 40


@pytest.mark.parametrize(
    ("field", "value", "fits"),
    [("altitudes_m", [80], "[80, 90] would fit"), ("cds_m", [[0, 0]], "[[0, 0], [0, 0]] would fit")],
)
def test_lists_that_are_given_and_do_not_fit_are_refused(field: str, value: list[float], fits: str) -> None:
    message = refusal(lambda: PAPER.replace(uavs=2, **{field: value}))
    assert f"{field}: has 1 entries, needs one for each of the 2 uavs" in message
    assert fits in message
    assert "uavs" in refusal(lambda: PAPER.replace(uavs=0))
    assert "uavs = '2'" in refusal(lambda: PAPER.replace(uavs="2"))


@given(st.lists(st.floats(1, 1e4), min_size=1, max_size=6, unique=True), st.integers(1, 60))
def test_altitudes_are_the_first_given_and_others_of_their_range(given_: list[float], uavs: int) -> None:
    altitudes = spread_altitudes(given_, uavs)
    assert len(set(altitudes)) == len(altitudes) == uavs
    assert altitudes[: len(given_)] == given_[:uavs]
    if max(given_) - min(given_) > 0.1:
        assert min(given_) <= min(altitudes)
        assert max(altitudes) <= max(given_)
    assert spread_altitudes([80.0], 3) == [80, 90, 100]
