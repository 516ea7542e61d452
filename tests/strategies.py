"""Hypothesis strategies: small valid scenarios, odd ones included, and arbitrary actions."""

from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from uavaou import Scenario

seeds = st.integers(0, 2**32 - 1)


@st.composite
def scenarios(draw: st.DrawFn, max_slots: int = 14, max_uavs: int = 3, max_devices: int = 6) -> Scenario:
    """Random valid small scenarios.

    They include one UAV, one device, K = 2, areas that are not square, a CDS anywhere on the grid, budgets
    that bind (down to take-off and landing alone, and exactly a whole number of moves), no fading, a
    resampled layout, a stated map and an ignored flight time. Ranges are such that R_min binds in part.
    """
    uavs = draw(st.integers(1, max_uavs))
    devices = draw(st.integers(1, max_devices))
    step = draw(st.sampled_from([100.0, 50.0, 33.3, 12.5, 0.7]))
    columns, rows = draw(st.integers(1, 4)), draw(st.integers(1, 4))  # grid steps along x and y
    slots = draw(st.integers(2, max_slots))
    speed = draw(st.sampled_from([15.0, 10.0, 7.3]))
    altitudes = draw(
        st.lists(st.sampled_from([60.0, 72.5, 80.0, 90.0, 100.0]), min_size=uavs, max_size=uavs, unique=True)
    )
    cells = st.tuples(st.integers(0, columns), st.integers(0, rows))
    fields: dict[str, Any] = {
        "area_x_m": columns * step,
        "area_y_m": rows * step,
        "grid_step_m": step,
        "uavs": uavs,
        "devices": devices,
        "slots": slots,
        "slot_length_s": draw(st.sampled_from([1.0, 20 / 3, 0.3])),
        "speed_m_s": speed,
        "altitudes_m": altitudes,
        "cds_m": [(x * step, y * step) for x, y in draw(st.lists(cells, min_size=uavs, max_size=uavs))],
        "rician_factor": draw(st.sampled_from([0.0, 1.0, 10.0])),
        "fading": draw(st.sampled_from(["rician", "none"])),
        "noise_power_dbm": -120.0,
        "layout": draw(st.sampled_from(["fixed", "resample"])),
        "layout_seed": draw(st.integers(0, 1000)),
        "flight_time": draw(st.sampled_from(["enforce", "enforce", "enforce", "ignore"])),
    }
    fields |= draw(radios())
    fields |= draw(st.sampled_from([{"carrier_frequency_hz": 3.5e9}, {"reference_gain_db": -43.3}]))
    moves = draw(st.integers(0, slots)) + draw(st.sampled_from([0.0, 0.5]))
    fields["flight_time_budget_s"] = (2 * max(altitudes) + moves * step) / speed
    fields |= draw(_device_fields(devices, columns * step, rows * step))
    return Scenario.from_dict(fields)


@st.composite
def radios(draw: st.DrawFn) -> dict[str, Any]:
    """What a radio needs to be in range, and in half of the draws a channel that is not the paper's.

    The SNR and the sensitivity are about those of the rate at the smallest bandwidth, so that they bind in part.
    """
    rates = [{"rate_min_bit_s": 150_000.0}, {"rate_min_bit_s": 120_000.0}]
    fields: dict[str, Any] = draw(st.sampled_from([*rates, {"snr_min_db": 30}, {"sensitivity_dbm": -91.5}]))
    if draw(st.booleans()):
        return fields
    sight = st.fixed_dictionaries(
        {
            "a": st.floats(1, 20),
            "b": st.floats(0.05, 1),
            "loss_los_db": st.floats(0, 2),
            "loss_nlos_db": st.floats(2, 30),
        }
    )
    return fields | {
        "path_loss_exponent": draw(st.floats(1.7, 2.6)),
        "excess_loss_db": draw(st.sampled_from([0, 3.0])),
        "antenna_gain_db": draw(st.sampled_from([0, 5.0, -2])),
        "line_of_sight": draw(st.one_of(st.none(), st.sampled_from(["suburban", "urban", "dense-urban"]), sight)),
    }


@st.composite
def _device_fields(draw: st.DrawFn, devices: int, width: float, height: float) -> dict[str, Any]:
    """What the devices are, as values, lists or ranges; where they stand, stated or drawn."""

    def one_each(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.lists(values, min_size=devices, max_size=devices)

    powers, periods = st.sampled_from([0.1, 0.3, 1.0]), st.integers(1, 5)
    fields: dict[str, Any] = {
        "bandwidth_hz": draw(st.one_of(st.just(15_000.0), st.just({"low": 15_000, "high": 20_000}))),
        "transmit_power_mw": draw(st.one_of(powers, one_each(powers), st.just({"low": 0.0, "high": 1.0}))),
        "update_period_slots": draw(st.one_of(periods, one_each(periods), st.just({"low": 1, "high": 5}))),
    }
    if draw(st.booleans()):
        # Thousandths of the area: a corner, a side and a point below a grid cell all occur.
        share = st.sampled_from([0, 1, 250, 500, 501, 777, 1000])
        spots = draw(st.lists(st.tuples(share, share), min_size=devices, max_size=devices, unique=True))
        fields["devices_m"] = [(min(x * width / 1000, width), min(y * height / 1000, height)) for x, y in spots]
    return fields


def random_actions(
    rng: np.random.Generator, missions: int, uavs: int, devices: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
    """One slot's actions for N missions: moves (N, U) and selections (N, U, I), or None for everything in range.

    A third of the missions push one way whatever the rules say, the rest are random.
    """
    moves = rng.integers(0, 5, size=(missions, uavs))  # (N, U)
    stubborn = np.arange(missions) % 3 == 0  # (N,)
    moves[stubborn] = (np.flatnonzero(stubborn)[:, None] // 3 + np.arange(uavs)) % 4 + 1
    if rng.random() < 0.2:
        return moves, None
    return moves, rng.random((missions, uavs, devices)) < rng.choice([0.2, 0.7, 1.0])
