"""Presets of radios, what they replace, and files and digests without them."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.scenario_files import refusal, write
from uavaou import Family, Scenario
from uavaou.radio import PAPER_CHANNEL
from uavaou.world.coverage import coverage_radius
from uavaou.zoo import zoo_names, zoo_path

PAPER = Scenario.load("paper")
# Of the files of presets before there were radios.
DIGESTS = {
    "paper": "3c32fdbee1964c07",
    "paper-table1": "d703957c2e4098af",
    "quickstart": "5d8957de236d8889",
    "tiny": "a9842d410b184288",
}


def radius(**changes: Any) -> float:
    """The widest radius of a device in m."""
    scenario = PAPER.replace(**changes)
    return float(np.nanmax(coverage_radius(scenario, scenario.draw_layout())))


def test_files_and_digests_are_what_they_were() -> None:
    for name, digest in DIGESTS.items():
        scenario = Scenario.load(name)
        assert hashlib.sha256(scenario.to_yaml().encode()).hexdigest()[:16] == digest
        for dump in (scenario.to_dict(), scenario.model_dump(), Family(base=scenario).to_dict()["base"]):
            assert not PAPER_CHANNEL.keys() & dump.keys()
    assert "excess" not in PAPER.model_dump_json()


def test_presets_have_plausible_radii() -> None:
    lora = [radius(radio=f"lora-sf{factor}") for factor in range(7, 13)]
    assert lora == sorted(lora)
    assert 2000 < lora[0] < 3000
    assert 8000 < lora[-1] < 10_000  # 10 to 15 km on the ground in the measurement of its path loss
    assert 300 < radius(radio="802.15.4") < 500
    assert 150 < radius(radio="ble") < radius(radio="802.15.4")
    assert 300 < radius(radio="wifi") < 500
    assert 3000 < radius(radio="nb-iot") < 6000
    assert radius(radio="lora-sf9", line_of_sight="urban") < radius(radio="lora-sf9") / 3


@pytest.mark.parametrize("name", zoo_names("radios"))
def test_each_number_of_a_preset_has_its_source(name: str) -> None:
    scenario = PAPER.replace(radio=name)
    assert Scenario.from_dict(scenario.to_dict()) == scenario
    assert scenario.replace(radio="paper") == PAPER
    for line in zoo_path("radios", name).read_text().splitlines():
        stated = name == "paper" or line.startswith(("#", "base:", "excess_loss_db: 0"))
        assert stated or "# " in line, line


def test_what_is_given_beside_a_radio_stays_and_it_replaces_the_rest(tmp_path: Path) -> None:
    text = "base: tiny\nradio: lora-sf9\nrate_min_bit_s: 300\ntransmit_power_mw: 14 dBm\n"
    scenario = Scenario.load(write(tmp_path, text))
    assert (scenario.rate_min_bit_s, scenario.snr_min_db, scenario.carrier_frequency_hz) == (300, None, 868e6)
    assert scenario.transmit_power_mw == pytest.approx(25.1188643)
    city = PAPER.replace(radio="ble", line_of_sight="urban", reference_gain_db=-40)
    assert (city.carrier_frequency_hz, city.sensitivity_dbm) == (None, -95)
    assert city.replace(radio="wifi").line_of_sight is None
    assert city.replace(rate_min_bit_s=1000).sensitivity_dbm is None
    assert Scenario.load(write(tmp_path, city.to_yaml())) == city


REFUSED: list[tuple[dict[str, Any], list[str]]] = [
    ({"radio": "lora-sf13"}, ["unknown radio 'lora-sf13'", "did you mean 'lora-sf12'?"]),
    ({"radio": ["ble"]}, ["unknown radio", "(known: 802.15.4, "]),
    ({"radoi": "ble"}, ["unknown field 'radoi'; did you mean 'radio'?"]),
    ({"line_of_sight": "city"}, ["line_of_sight = 'city': must be none, suburban, urban, dense-urban or {a, b,"]),
    ({"line_of_sight": {"a": 1, "b": 1, "loss_los_db": 3, "loss_nlos_db": 2}}, ["loss_los_db (3)", "must not exceed"]),
    (
        {"line_of_sight": {"a": 0, "b": 1, "loss_los_db": 3, "loss_nlos_db": 9}},
        ["line_of_sight.a = 0", "greater than 0"],
    ),
    ({"path_loss_exponent": 0.5}, ["path_loss_exponent = 0.5", "greater than or equal to 1"]),
    ({"excess_loss_db": -1}, ["excess_loss_db = -1"]),
    ({"rate_min_bit_s": None}, ["rate_min_bit_s", "snr_min_db", "sensitivity_dbm", "one of the three"]),
    ({"snr_min_db": 3, "sensitivity_dbm": -90}, ["one of the three"]),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED, ids=[str(changes)[:50] for changes, _ in REFUSED])
def test_radios_that_cannot_be_used_are_refused_in_one_line(changes: dict[str, Any], words: list[str]) -> None:
    message = refusal(lambda: PAPER.replace(**changes))
    assert all(word in message for word in ("paper", *words)), message


def test_an_unknown_radio_of_a_file_stands_beside_its_other_faults(tmp_path: Path) -> None:
    message = refusal(lambda: Scenario.load(write(tmp_path, "base: tiny\nradio: lora\nslots: 1\n")))
    assert "2 faults" in message
    assert "unknown radio 'lora'; did you mean" in message
