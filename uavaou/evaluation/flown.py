"""An evaluation as rows of the table of flights."""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaou.evaluation.evaluate import Evaluation
from uavaou.evaluation.flights import DEVICES, PERIODS, SLOTS, Flights
from uavaou.planners.base import Planner
from uavaou.scenario import Scenario
from uavaou.statistics import Band, band_over_missions
from uavaou.world.knowledge import knowledge


def flown(evaluation: Evaluation, scenario: Scenario, policy: Planner, first: int, /, **who: Any) -> Flights:
    """The rows of an evaluation: its missions, and its means over slots, devices and periods.

    Devices and periods have none where each mission draws a layout, in which a device has no place of its own.

    Args:
        evaluation: of the missions.
        scenario: that was flown.
        policy: that flew.
        first: seed of mission 0.
        who: further columns of :data:`~uavaou.evaluation.flights.FLIGHTS`, such as ``policy`` and ``scenario``.
    """
    tau, missions = scenario.slot_length_s, len(evaluation.aou_over_time_s)
    measured = evaluation.age_of_information
    flights = {
        "mission_seed": np.arange(first, first + missions),
        "mean_aou_slots": evaluation.values("mean_aou_s") / tau,
        "violations": np.array([sum(counts.values()) for counts in evaluation.broken]),
        "flight_time_s": evaluation.values("flight_time_s").sum(axis=1),
        **{name: evaluation.values(name) for name in _COUNTS},
        "late_share": measured.get("late_share"),
        **{f"{name}_slots": measured[f"{name}_s"] / tau for name in ("mean_aoi", "peak_aoi") if measured},
        "knows": knowledge(policy),
        "action": getattr(policy, "action", None),  # planners have neither
        "digest": getattr(policy, "digest", None) or None,
    }
    curves = [_curve(SLOTS, np.arange(1, scenario.slots + 1), "mean_aou_slots", evaluation.aou_over_time_s / tau)]
    if scenario.layout == "fixed":
        period = scenario.draw_layout().update_period  # (I,)
        counts = evaluation.values("device_communications")  # (N, I)
        ages = evaluation.values("device_mean_aou_s").mean(axis=0) / tau  # (I,)
        devices = {"communications": counts.mean(axis=0), "mean_aou_slots": ages}
        curves.append({"curve": DEVICES, "x": np.arange(len(period)), **devices})
        every = np.unique(period)
        alike = np.stack([counts[:, period == one].mean(axis=1) for one in every], axis=1)  # (N, P)
        curves.append(_curve(PERIODS, every, "communications", alike))
    return Flights.of(flights, curves, **who)


_COUNTS = ("communications", "devices_served", "rejected_rate", "rejected_association")


def _curve(name: str, x: Any, column: str, values: Any) -> dict[str, Any]:
    """The means of values (N, X) with their intervals over missions; without them for one mission."""
    band: Band = band_over_missions(values)
    return {"curve": name, "x": x, column: band.value, "low": band.low, "high": band.high}
