"""Writes the results of a study that never ran, with properties that are known beforehand."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uavaou import Scenario
from uavaou.evaluation.flights import BOUND, SAMPLED, SLOTS, TRAINING, VALIDATION, Flights
from uavaou.evaluation.flights import DEVICES as OF_DEVICES
from uavaou.evaluation.flights import PERIODS as BY_PERIOD
from uavaou.evaluation.recorded_mission import RecordedMission, record_mission, write_mission
from uavaou.planners import make_planner, planner_knowledge

DEVICES = 10
PERIODS = 1 + np.arange(DEVICES) % 5  # k_i
_PLACES = np.random.default_rng(0).uniform(0, 400, (DEVICES, 2)).round().tolist()
SCENARIO = Scenario.load("quickstart").replace(devices=DEVICES, devices_m=_PLACES, update_period_slots=PERIODS.tolist())
K, SLOT_S = SCENARIO.slots, SCENARIO.slot_length_s
BUDGET, EVALUATIONS, GROUPS = 60_000, 30, 20


@dataclass(frozen=True)
class Variant:
    """What a synthetic policy does; ages in slots."""

    aou: float = 40.0  # mean over slots
    spread: float = 0.02  # of seeds and of missions, as a share
    converges: float = 20_000  # training slots until within a few per cent of the last level
    communications: float = 300.0
    served: float = 10.0
    by_period: float = -10.0  # communications that a device loses for each slot of k_i
    algorithm: str = ""


MAPPO = Variant(40.0, converges=15_000, communications=400.0)
VDN = Variant(100.0, converges=50_000, communications=300.0, served=8.0)
QMIX = Variant(160.0, converges=40_000, communications=250.0, served=7.0)
DEFAULT = {"mappo": MAPPO, "qmix": QMIX, "vdn": VDN}
PLANNERS = {"greedy": Variant(80.0), "best-first": Variant(60.0), "random": Variant(5000.0)}


def write_study(
    folder: Path,
    variants: Mapping[str, Variant] = DEFAULT,
    planners: Mapping[str, Variant] = PLANNERS,
    seeds: int = 4,
    scenarios: Sequence[str] = ("paper",),
    missions: int = 12,
    bound: float | None = 25.0,
) -> Path:
    """Write a study's tables to ``folder`` and return it."""
    folder.mkdir(parents=True)
    parts: list[Flights] = []
    for scenario in scenarios:
        for number, (name, variant) in enumerate(variants.items()):
            for seed in range(seeds):
                rng = np.random.default_rng([number, seed, len(scenario)])
                parts.append(_trained(name, variant, missions, rng).with_values(scenario=scenario, seed=seed))
        for number, (name, planner) in enumerate(planners.items()):
            flown = _flown(planner, missions, np.random.default_rng([99, number]))
            parts.append(flown.with_values(policy=name, scenario=scenario, knows=planner_knowledge(name)))
        if bound is not None:
            parts.append(Flights.of({"mean_aou_slots": [bound]}, policy=BOUND, scenario=scenario))
    Flights.joined(parts).write(folder)
    stated: dict[str, Any] = {"description": "synthetic", "seeds": list(range(seeds)), "planners": list(planners)}
    stated["scenarios"] = {name: SCENARIO.to_dict() for name in scenarios}
    stated["variants"] = {name: {"name": variant.algorithm or name} for name, variant in variants.items()}
    (folder / "study.yaml").write_text(yaml.safe_dump(stated), encoding="utf-8")
    return folder


def _trained(name: str, variant: Variant, missions: int, rng: np.random.Generator) -> Flights:
    own = variant.aou * (1 + variant.spread * rng.standard_normal())
    groups = np.linspace(BUDGET / GROUPS, BUDGET, GROUPS).astype(int)
    ages = np.array(
        [own * _learning(slots, variant.converges) * (1 + 0.05 * rng.standard_normal()) for slots in groups]
    )
    curves: list[dict[str, Any]] = [{"curve": TRAINING, "x": groups, "wall_s": 1e-3 * groups, "mean_aou_slots": ages}]
    curves[0] |= {"communications": variant.communications, "devices_served": 8.0}
    evaluations = np.linspace(BUDGET / EVALUATIONS, BUDGET, EVALUATIONS).astype(int)
    levels = np.array([own * _learning(slots, variant.converges) for slots in evaluations])
    for curve in (VALIDATION, SAMPLED):
        curves.append({"curve": curve, "x": evaluations, "wall_s": 1e-3 * evaluations, "mean_aou_slots": levels})
    rows = Flights.joined([_flown(variant, missions, rng), Flights.of({"x": []}, curves)])
    facts = {"slots": BUDGET, "agent_steps": 3 * BUDGET, "wall_s": 1e-3 * BUDGET, "cpu_s": 1e-3 * BUDGET}
    facts |= {"best_slots": own, "commit": "0" * 40, "processor": "one", "knows": "local"}
    flights = rows.with_values(policy=name, algorithm=variant.algorithm or name).flights.assign(**facts)
    return Flights(flights, rows.with_values(policy=name).curves)


def _learning(slots: float, converges: float) -> float:
    """From 100 times the last level down to it; 5 % above it at ``converges``."""
    return float(1 + 99 * np.exp(-np.log(99 / 0.05) * slots / converges))


def _flown(variant: Variant, missions: int, rng: np.random.Generator) -> Flights:
    own = variant.aou * (1 + variant.spread * rng.standard_normal())
    spread = 1 + variant.spread * rng.standard_normal((2, missions))
    flights = {
        "mission_seed": np.arange(10_000, 10_000 + missions),
        "mean_aou_slots": own * spread[0],
        "communications": np.round(variant.communications * spread[1]),
        "devices_served": variant.served,
        "violations": 0,
    }
    slots = np.arange(1, K + 1)
    counts = variant.communications / DEVICES + variant.by_period * (PERIODS - 3) + rng.standard_normal(DEVICES)
    each = np.array([counts[period == PERIODS].mean() for period in np.unique(PERIODS)])
    curves = [
        {"curve": SLOTS, "x": slots, "mean_aou_slots": own * (1 - np.exp(-slots / 10)) * rng.uniform(0.9, 1.1, K)},
        {"curve": OF_DEVICES, "x": np.arange(DEVICES), "communications": counts, "mean_aou_slots": own / DEVICES},
        {"curve": BY_PERIOD, "x": np.unique(PERIODS), "communications": each},
    ]
    return Flights.of(flights, curves)


def edit(folder: Path, change: Callable[[Flights], Flights]) -> None:
    """Change the tables of a folder."""
    change(Flights.read(folder)).write(folder)


def set_to(folder: Path, column: str, value: object, **wanted: Any) -> None:
    """Give a column of flights another value, in the rows with these values."""

    def change(table: Flights) -> Flights:
        table.flights.loc[table.where(**wanted).flights.index, column] = value
        return table

    edit(folder, change)


def without(folder: Path, **wanted: Any) -> None:
    """Remove the rows with these values from the tables of a folder."""

    def change(table: Flights) -> Flights:
        gone = table.where(**wanted)
        frames = ((table.flights, gone.flights), (table.curves, gone.curves))
        return Flights(*(frame.drop(index=out.index) for frame, out in frames))

    edit(folder, change)


def record(folder: Path, policy: str = "mappo", planner: str = "greedy") -> RecordedMission:
    """Write ``mission-<policy>.json``, flown by a planner."""
    scenario = Scenario.load("tiny")
    recording = record_mission(scenario, make_planner(planner), 5)
    mission = RecordedMission(scenario, policy, 0, 5, recording)
    write_mission(folder / f"mission-{policy}.json", mission)
    return mission
