"""The bound that keeps the fleet whole, and the certificate of a bound."""

from pathlib import Path

import numpy as np
import pytest

from tests.planners.test_bound import most_prices
from tests.planners.verify_certificate import verify
from uavaou import InputError, Scenario
from uavaou.planners.bound import Bound, BoundSearch, LagrangianRelaxation
from uavaou.planners.certificate import read_certificate, write_certificate
from uavaou.planners.fleet import FleetDecomposition

pytestmark = pytest.mark.slow

FADING = Scenario.load("tiny").replace(fading="rician", slots=6, transmit_power_mw=0.25)
LAYOUT = FADING.draw_layout()


def test_any_prices_bound_and_the_slope_is_theirs() -> None:
    fleet, rng = FleetDecomposition(FADING, LAYOUT), np.random.default_rng(0)
    prices = 0.3 * rng.random((7, 2, 4, 9, 5))
    value, slope = fleet.bound(prices)
    for _ in range(5):
        along = rng.standard_normal(prices.shape)
        moved, _ = fleet.bound(prices + 1e-6 * along)
        assert (moved - value) / 1e-6 == pytest.approx((slope * along).sum(), rel=1e-3)
        far, _ = fleet.bound(prices + along)  # concave: below the tangent
        assert far <= value + (slope * along).sum() + 1e-6


def test_a_whole_fleet_is_no_weaker_than_prices_on_collections() -> None:
    relaxation = LagrangianRelaxation(FADING, LAYOUT)
    relaxation.prices[1:] = np.random.default_rng(1).random((6, 4))
    total, _ = relaxation.bound(relaxation.prices)
    assert FleetDecomposition(FADING, LAYOUT).bound(relaxation.as_charges()[1])[0] >= total - 1e-9


@pytest.mark.parametrize(
    ("method", "hold"),
    [("linear program", "slot"), ("fleet", "slot"), ("copies", "slot"), ("copies", "period"), ("copies", "always")],
)
def test_a_certificate_is_verified_and_resumed(
    method: str, hold: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaou.planners.decomposition._MOST_PRICES", most_prices(FADING, hold))
    if method != "linear program":
        monkeypatch.setattr("uavaou.planners.bound._LARGEST_PROGRAM", 0)
    if method != "fleet":
        monkeypatch.setattr(FleetDecomposition, "affordable", lambda _: False)
    monkeypatch.setattr("uavaou.planners.bound._ROUNDS_FLEET", 5)
    monkeypatch.setattr("uavaou.planners.bound._ROUNDS_SHORT", 5)
    monkeypatch.setattr("uavaou.planners.bound._ROUNDS_LONG", 5)
    bound, path = BoundSearch(FADING, LAYOUT).run(), tmp_path / "bound.npz"
    assert bound.method in (method, "prices")
    if hold != "slot":
        assert len(bound.multipliers["prices"]) == (1 if hold == "always" else max(LAYOUT.update_period))
    write_certificate(path, FADING, LAYOUT, bound)
    claimed, proven = verify(path)
    assert claimed == bound.mean_aou_s > 0
    assert claimed <= proven * (1 + 1e-9)
    again = read_certificate(path, FADING)
    assert BoundSearch(FADING, LAYOUT, start=again).run().mean_aou_s >= bound.mean_aou_s * (1 - 1e-9)


@pytest.mark.parametrize("radio", ["ble", "lora-sf7"])
def test_a_certificate_of_another_radio_is_verified(radio: str, tmp_path: Path) -> None:
    power = "-9 dBm" if radio == "ble" else "-50 dBm"
    city = FADING.replace(radio=radio, line_of_sight="urban", transmit_power_mw=power, antenna_gain_db=1)
    bound, path = BoundSearch(city, city.draw_layout()).run(), tmp_path / "bound.npz"
    write_certificate(path, city, city.draw_layout(), bound)
    claimed, proven = verify(path)
    assert 0 < claimed <= proven * (1 + 1e-9)
    assert claimed == pytest.approx(proven, rel=1e-6)


def test_a_certificate_is_of_one_scenario(tmp_path: Path) -> None:
    path = tmp_path / "made" / "bound.npz"
    write_certificate(path, FADING, LAYOUT, Bound(1.0, "prices"))
    with pytest.raises(InputError, match="another scenario"):
        read_certificate(path, FADING.replace(slots=7))
    write_certificate(path, FADING, LAYOUT, Bound(1.0, "fleet", {"prices": np.zeros((2, 2))}))
    with pytest.raises(InputError, match="do not fit"):
        read_certificate(path, FADING)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="damaged"):
        read_certificate(path, FADING)
