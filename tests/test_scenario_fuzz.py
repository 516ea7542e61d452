"""Scenarios of extreme and random values: refused in one line, or accepted and playable."""

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scenario_files import refusal
from uavaou import InputError, Scenario, World

TINY = Scenario.load("tiny")


def nested(depth: int) -> list[Any]:
    """A list in a list in a list."""
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value


EXTREMES: list[dict[str, Any]] = [
    {"slots": 10**5000},
    {"area_x_m": 10**400},
    {"area_x_m": 1e308, "grid_step_m": 1e-5},
    {"cds_m": [[1e308, 0], [0, 0]], "area_x_m": 0.01, "area_y_m": 0.01, "grid_step_m": 0.01},
    {"slots": nested(20_000)},
    {"bandwidth_hz": nested(20_000)},
    {"cds_m": [[[[[]]]], {}]},
    {"update_period_slots": [10**400] * 4},
    {"\ud800": 1},
    {"name": "\ud800"},
    {"": None},
]


@pytest.mark.parametrize("changes", EXTREMES, ids=[f"{number}: {list(c)}" for number, c in enumerate(EXTREMES)])
def test_extreme_values_are_refused_or_accepted_but_never_crash(changes: dict[str, Any]) -> None:
    with suppress(InputError):
        Scenario.from_dict(TINY.to_dict() | changes)


EXTREMES_THAT_LOAD: list[dict[str, Any]] = [
    {"flight_time_budget_s": 1e25},
    {"noise_power_dbm": 1e6},
    {"noise_power_dbm": -1e6},
    {"reference_gain_db": 1e6},
    {"carrier_frequency_hz": 1e-300},
    {"update_period_slots": 10**30},
    {"update_period_slots": {"low": 1, "high": 10**30}},
    {"slot_length_s": 1e-300},
    {"slot_length_s": 1e-300, "energy": {"model": "rotary-wing", "battery_wh": 1e-15}},
    {"energy": {"model": "rotary-wing", "battery_wh": 80, "induced_velocity_m_s": 1e-200}},
    {"energy": {"endurance_s": 1e15}, "swap_time_s": 1e15, "slot_length_s": 1e-9},
    {"wind": {"east_m_s": 100, "deviation_m_s": 30, "correlation": 1 - 1e-16}, "links": {"range_m": 1e15}},
    {"age_limit_s": 1e-300, "objective": "above-limit", "device_weights": [1e15, 0, 0, 1e-300]},
]


@pytest.mark.parametrize("changes", EXTREMES_THAT_LOAD, ids=str)
@pytest.mark.filterwarnings("error")
def test_what_is_accepted_can_be_played(changes: dict[str, Any]) -> None:
    """An absurd quantity is refused when it is loaded, or simulated; it does not fail later."""
    try:
        scenario = TINY.replace(**changes)
    except InputError:
        return
    world = World(scenario)
    assert np.isfinite(world.snr).all()
    assert (world.update_period >= 1).all()
    assert world.allowed_moves[..., 0].all()


junk = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(-(10**320), 10**320)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=4)
    | st.dates()
    | st.sampled_from(["paper", "1e3", "none", "", "\0"]),
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.dictionaries(st.text(max_size=5) | st.sampled_from(["low", "high"]), inner, max_size=3)
        | st.tuples(inner, inner)
    ),
    max_leaves=12,
)
near_numbers = st.sampled_from([0, 1, 2, 3, -1, 1.0, 0.1, 1e-12, 1e12, 1e300, 10**20, -0.0, 100, 200, 5e-324])
fields = st.sampled_from(sorted(Scenario.model_fields)) | st.text(max_size=6)


@settings(max_examples=100)
@given(st.dictionaries(fields, junk, max_size=8))
def test_junk_is_refused_politely(mapping: dict[str, Any]) -> None:
    assert refusal(lambda: Scenario.from_dict(mapping))


@settings(max_examples=150)
@given(changes=st.dictionaries(fields, junk | near_numbers, min_size=1, max_size=4))
def test_a_good_scenario_with_junk_in_it_is_refused_politely(changes: dict[str, Any]) -> None:
    for action in (lambda: TINY.replace(**changes), lambda: Scenario.from_dict(TINY.to_dict() | changes)):
        with suppress(InputError):  # nothing else may be raised
            action()
