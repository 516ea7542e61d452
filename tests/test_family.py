"""Families of scenarios: draws depend on their number alone, lie within the bounds, and errors are one line."""

import hashlib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaou import Family, InputError, Scenario
from uavaou.family import Draw, WholeDraw, beyond
from uavaou.zoo import zoo_names

DRAWS = range(300)


@cache
def drawn(name: str) -> list[Scenario]:
    """The first 1000 draws of a shipped family."""
    family = Family.load(name)
    return [family.draw(n) for n in range(1000)]


def test_a_draw_depends_on_its_number_alone() -> None:
    other = Family.load("any")
    backwards = {n: other.draw(n) for n in reversed(DRAWS)}
    assert all(drawn("any")[n] == backwards[n] for n in DRAWS)
    assert len({backwards[n].to_yaml() for n in DRAWS}) == len(DRAWS)  # the name holds the number


def test_the_draws_stay_what_they_were() -> None:
    """Trainings resume with the same scenarios: a change of these numbers changes every family."""
    text = "".join(f"{scenario.to_dict()}" for scenario in drawn("any")[:20])
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "ea2f5711870c7d86"


def test_a_field_more_does_not_shift_the_others() -> None:
    family = Family.load("any")
    more = Family.from_dict(family.to_dict() | {"rician_factor": {"among": [7]}, "slots": {"low": 50, "high": 60}})
    same = ("uavs", "devices", "area_x_m", "cds_m", "altitudes_m", "rate_min_bit_s", "update_period_slots")
    for n in DRAWS:
        one, other = drawn("any")[n], more.draw(n)
        assert all(getattr(one, name) == getattr(other, name) for name in same)


@pytest.mark.parametrize("name", zoo_names("families"))
def test_shipped_families_are_what_their_files_say(name: str) -> None:
    family = Family.load(name)
    assert family.name == name
    assert family.description
    assert Family.from_dict(family.to_dict()) == family
    assert all(scenario.layout == "resample" for scenario in drawn(name))
    for position, of in enumerate(("uavs", "devices")):
        assert max(getattr(scenario, of) for scenario in drawn(name)) <= family.most[position]
    assert not any(beyond(family, scenario) for scenario in drawn(name))


def test_any_draws_widely_and_often_the_base() -> None:
    some = drawn("any")
    paper = Scenario.load("paper").to_dict() | {"layout": "resample"}
    share = np.mean([scenario.to_dict() | {"name": "paper"} == paper for scenario in some])
    assert share == pytest.approx(0.3, abs=0.04)
    for name, low, high in (
        ("uavs", 1, 10),
        ("devices", 5, 500),
        ("area_x_m", 450, 3000),
        ("slots", 150, 800),
        ("rician_factor", 0, 30),
        ("rate_min_bit_s", 1e5, 1.8e5),
        ("grid_step_m", 25, 150),
        ("longest_update_period", 1, 60),
    ):
        values = [getattr(scenario, name) for scenario in some]
        assert low <= min(values) < low * 1.1 + 10
        assert high * 0.9 < max(values) <= high
    assert any(len(set(scenario.cds_m)) == 1 < scenario.uavs for scenario in some)
    assert any(scenario.area_x_m != scenario.area_y_m for scenario in some)
    altitudes = [altitude for scenario in some for altitude in scenario.altitudes_m]
    assert 60 <= min(altitudes) < 65
    assert 115 < max(altitudes) <= 120
    assert np.mean([scenario.devices_m is not None for scenario in some]) == pytest.approx(0.7 * 0.3, abs=0.04)


def test_slots_and_steps_take_time_in_proportion() -> None:
    family = Family.from_dict({"base": "paper", "slots": {"among": [250]}, "grid_step_m": {"among": [50]}})
    base, drawn = family.base, family.draw(3)
    assert drawn.slot_length_s == pytest.approx(base.slot_length_s / 2)
    assert drawn.flight_time_budget_s == pytest.approx(base.flight_time_budget_s / 4)
    assert (drawn.columns, drawn.rows) == (21, 21)


@pytest.mark.parametrize("kind", ["corners", "edges", "common", "scattered"])
def test_cdss_lie_where_they_should(kind: str) -> None:
    family = Family.from_dict({"base": "paper", "uavs": {"among": [6]}, "cds": {kind: 1}})
    for n in range(50):
        scenario = family.draw(n)
        cells = scenario.cds_cells  # (U, 2)
        at_end = (cells == 0) | (cells == [scenario.columns - 1, scenario.rows - 1])
        if kind == "corners":
            assert at_end.all()
            assert len({tuple(cell) for cell in cells[:4].tolist()}) == 4
        elif kind == "edges":
            assert at_end.any(axis=1).all()
        elif kind == "common":
            assert len(set(scenario.cds_m)) == 1


def test_devices_lie_in_clusters() -> None:
    family = Family.from_dict({"base": "paper", "clusters": {"among": [2]}, "devices": {"among": [60]}})
    away = []
    for n in range(20):
        scenario = family.draw(n)
        places = np.array(scenario.devices_m) / 1000  # (I, 2)
        assert (places >= 0).all()
        assert (places <= 1).all()
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        centres = places[list(np.unravel_index(apart.argmax(), apart.shape))]
        for _ in range(20):  # Lloyd's algorithm, from the two that are farthest apart
            nearest = np.linalg.norm(places[:, None] - centres, axis=-1).argmin(axis=1)
            centres = np.array([places[nearest == k].mean(axis=0) for k in range(2)])
        away.append(np.linalg.norm(places - centres[nearest], axis=1).mean())
    assert np.mean(away) == pytest.approx(0.08 * np.sqrt(np.pi / 2), rel=0.2)
    assert family.draw(3).devices_m != family.draw(4).devices_m
    assert Family.from_dict(family.to_dict() | {"clusters": {"among": [2], "share": 0}}).draw(3).devices_m is None


def test_draws_are_uniform_or_log_uniform() -> None:
    rng = np.random.default_rng(0)
    values = [WholeDraw(low=1, high=4).value(rng) for _ in range(4000)]
    np.testing.assert_allclose(np.bincount(np.array(values, int), minlength=5)[1:] / 4000, 0.25, atol=0.03)
    logarithms = np.log([Draw(low=10, high=1000, log=True).value(rng) for _ in range(4000)])
    assert np.mean(logarithms < np.log(100)) == pytest.approx(0.5, abs=0.03)
    some = [Draw(among=(0, 7), weights=(3, 1)).value(rng) for _ in range(4000)]
    assert np.mean(some) == pytest.approx(7 / 4, abs=0.15)


def test_a_base_may_be_a_file_or_fields(tmp_path: Path) -> None:
    own = Scenario.load("tiny").replace(name="own")
    (tmp_path / "own.yaml").write_text(own.to_yaml())
    (tmp_path / "few.yaml").write_text(f"base: {tmp_path / 'own.yaml'}\ndevices: {{low: 2, high: 3}}\n")
    family = Family.load(tmp_path / "few.yaml")
    assert (family.name, family.base, family.most) == ("few", own, (2, 4))
    assert family.varies_in_size
    assert not Family.load("layouts").varies_in_size
    assert Family.load(family) is family


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"devics": {"low": 1, "high": 2}}, "unknown field 'devics'; did you mean 'devices'?"),
        ({"uavs": {"lwo": 1, "high": 2}}, "uavs.lwo = 1: unknown key"),
        ({"uavs": 3}, "uavs = 3: expected a mapping"),
        ({"uavs": {"low": 3}}, "give low and high, or among"),
        ({"uavs": {"low": 3, "high": 2}}, "low (3) must not exceed high (2)"),
        ({"uavs": {"low": 0, "high": 2}}, "uavs.low = 0: must be greater than or equal to 1"),
        ({"uavs": {"among": [1, 2], "weights": [1]}}, "weights: has 1 entries, needs one for each value of among"),
        ({"rician_factor": {"low": 0, "high": 9, "log": True}}, "log: needs a low above 0"),
        ({"cds": {"corners": 0}}, "expected a weight above 0"),
        ({"base": "papr"}, "did you mean 'paper'?"),
        ({"base_share": 2}, "base_share = 2: must be less than or equal to 1"),
        ({"name": "a/b"}, "must be usable as a folder name"),
        ({"slots": {"low": 1, "high": 5}}, "(1) slots = 1.0: must be"),
        ({"altitudes_m": {"low": 80, "high": 80}}, "draw 0 cannot be flown: scenario 'paper': altitudes_m = [80"),
        ({"altitudes_m": {"low": 4e4, "high": 5e4}}, "breaks constraint (Time)"),
    ],
)
def test_errors_are_one_line(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        Family.from_dict({"base": "paper"} | fields)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_names_and_numbers_are_refused() -> None:
    with pytest.raises(InputError, match="unknown family 'anny'; did you mean 'any'"):
        Family.load("anny")
    for n in (-1, 1.5):
        with pytest.raises(InputError, match="expected a whole number from 0 on"):
            Family.load("layouts").draw(n)  # type: ignore[arg-type]


NUMBERS = st.one_of(st.sampled_from([0, 1, 2, 1e-3, 1e15, 1e300, -1, 10**400, None, "5", True]), st.floats(0.5, 500))
DRAWS_OF_FIELDS = st.one_of(
    NUMBERS,
    st.fixed_dictionaries({}, optional={"low": NUMBERS, "high": NUMBERS, "log": st.booleans(), "share": NUMBERS}),
    st.fixed_dictionaries({"among": st.lists(NUMBERS, max_size=3)}, optional={"weights": st.lists(NUMBERS)}),
)
FIELDS = st.sampled_from([name for name in Family.model_fields if name != "base"])


@settings(max_examples=150, deadline=None)
@given(st.dictionaries(FIELDS, DRAWS_OF_FIELDS, max_size=3))
def test_extreme_values_are_refused_or_accepted_but_never_crash(fields: dict[str, Any]) -> None:
    with suppress(InputError):
        family = Family.from_dict({"base": "tiny"} | fields)
        assert Family.from_dict(family.to_dict()) == family


def test_what_is_beyond_all_families_is_named_with_both_ends() -> None:
    paper, any_ = Scenario.load("paper"), Family.load("any")
    many = Family.from_dict(any_.to_dict() | {"base_share": 0.0, "devices": {"low": 60, "high": 200}})
    wide = paper.replace(area_x_m=9000)
    assert beyond(any_, wide) == ["sides 1,000 to 9,000 m (in training 500 to 3,000 m)"]
    few = paper.replace(devices=10)
    assert beyond(many, few) == ["devices 10 (in training 60 to 200)"]
    assert beyond(any_, few) == []
    radio = paper.replace(transmit_power_mw=25, carrier_frequency_hz=868e6, rate_min_bit_s=5470)
    assert [text.split(" (")[0] for text in beyond(any_, radio)] == [
        "minimum rates 5,470 bit/s",
        "transmit powers 25 mW",
        "reference gains -31.22 dB",
    ]
    city = paper.replace(snr_min_db=30, path_loss_exponent=2.4, line_of_sight="urban")
    assert beyond(any_, city) == [
        "in range by the minimum SNR of 30 dB (in training by minimum rates)",
        "path-loss exponents 2.4 (in training 2)",
        "losses by the line of sight (in training others)",
    ]
    assert Family(base=city, devices={"among": [5]}).draw(3).snr_min_db == 30


def test_a_base_that_is_never_drawn_is_beyond() -> None:
    family = Family.from_dict({"base": "paper", "devices": {"low": 40, "high": 60}})
    assert beyond(family, Scenario.load("paper")) == ["devices 25 (in training 40 to 60)"]
    assert beyond(Family.from_dict(family.to_dict() | {"base_share": 0.1}), Scenario.load("paper")) == []


def test_missions_as_they_go_are_drawn_over_the_same_maps() -> None:
    plain = Family.load("any")
    names = ("uplinks_per_slot", "energy", "failure_probability_per_slot", "links", "wind", "devices_silent")
    going = drawn("any-mission")
    for n, scenario in enumerate(going[:50]):
        without = dict.fromkeys((*names, "swap_time_s"))
        assert scenario.replace(**without, name=f"any-{n}") == drawn("any")[n]
    shares = {name: np.mean([getattr(scenario, name) is not None for scenario in going]) for name in names}
    assert all(0.1 < share < 0.5 for share in shares.values()), shares
    assert beyond(plain, Scenario.load("paper").replace(links="none")) == ["links (in training none)"]
