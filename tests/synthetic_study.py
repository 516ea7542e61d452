"""Writes the results of a study that never ran, with properties that are known beforehand."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from uavaou import Scenario
from uavaou.evaluation.recorded_mission import RecordedMission, record_mission, write_mission
from uavaou.planners import make_planner
from uavaou.studies.results import COLUMNS

DEVICES = 10
SCENARIO = Scenario.load("quickstart").replace(devices=DEVICES)
K, SLOT_S = SCENARIO.slots, SCENARIO.slot_length_s
BUDGET, EVALUATIONS, GROUPS = 60_000, 30, 20
PERIODS = 1 + np.arange(DEVICES) % 5  # k_i


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


@dataclass
class _Tables:
    rows: dict[str, list[list[Any]]] = field(default_factory=lambda: {name: [] for name in COLUMNS})


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
    tables = _Tables()
    for scenario in scenarios:
        for number, (name, variant) in enumerate(variants.items()):
            for seed in range(seeds):
                rng = np.random.default_rng([number, seed, len(scenario)])
                _train(tables, name, variant, scenario, seed, rng)
                _execute(tables, name, variant, scenario, str(seed), missions, rng)
        for number, (name, planner) in enumerate(planners.items()):
            _execute(tables, name, planner, scenario, "", missions, np.random.default_rng([99, number]))
        if bound is not None:
            tables.rows["bounds"].append([scenario, bound, "copies"])
    for name, header in COLUMNS.items():
        _write(folder / f"{name}.csv", header, tables.rows[name])
    stated = {
        "description": "synthetic", "seeds": list(range(seeds)), "planners": list(planners),
        "scenarios": {name: SCENARIO.to_dict() for name in scenarios},
        "variants": {name: {"name": variant.algorithm or name} for name, variant in variants.items()},
    }  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(stated), encoding="utf-8")
    return folder


def _train(tables: _Tables, name: str, variant: Variant, scenario: str, seed: int, rng: np.random.Generator) -> None:
    algorithm = variant.algorithm or name
    own = variant.aou * (1 + variant.spread * rng.standard_normal())
    wall_s = 1e-3 * BUDGET
    tables.rows["runs"].append(
        [name, algorithm, scenario, seed, BUDGET, 3 * BUDGET, wall_s, wall_s, BUDGET, own, own, own, 0, "0" * 40, "one"]
    )
    for slots in np.linspace(BUDGET / GROUPS, BUDGET, GROUPS).astype(int):
        aou = own * _learning(slots, variant.converges) * (1 + 0.05 * rng.standard_normal())
        row = [name, scenario, seed, slots, 1e-3 * slots, -aou * K * SLOT_S, aou, variant.communications, 8]
        tables.rows["curves"].append(row)
    for slots in np.linspace(BUDGET / EVALUATIONS, BUDGET, EVALUATIONS).astype(int):
        aou = own * _learning(slots, variant.converges)
        tables.rows["validation"].append([name, scenario, seed, slots, 1e-3 * slots, aou, aou])


def _learning(slots: float, converges: float) -> float:
    """From 100 times the last level down to it; 5 % above it at ``converges``."""
    return float(1 + 99 * np.exp(-np.log(99 / 0.05) * slots / converges))


def _execute(
    tables: _Tables, name: str, variant: Variant, scenario: str, seed: str, missions: int, rng: np.random.Generator
) -> None:
    own = variant.aou * (1 + variant.spread * rng.standard_normal())
    for mission in range(missions):
        aou = own * (1 + variant.spread * rng.standard_normal())
        done = round(variant.communications * (1 + variant.spread * rng.standard_normal()))
        tables.rows["missions"].append([name, scenario, seed, mission, aou, -aou * K * SLOT_S, done, variant.served])
    for slot in range(1, K + 1):
        aou = own * (1 - np.exp(-slot / 10)) * rng.uniform(0.9, 1.1)
        tables.rows["execution"].append([name, scenario, seed, slot, aou])
    places = np.random.default_rng(0).uniform(0, 400, (DEVICES, 2))
    for device, (x, y) in enumerate(places):
        period = PERIODS[device]
        served = variant.communications / DEVICES + variant.by_period * (period - 3) + rng.standard_normal()
        row = [name, scenario, seed, device, x, y, period, served, own / DEVICES]
        tables.rows["devices"].append(row)


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def record(folder: Path, policy: str = "mappo", planner: str = "greedy") -> RecordedMission:
    """Write ``mission-<policy>.json``, flown by a planner."""
    scenario = Scenario.load("tiny")
    recording = record_mission(scenario, make_planner(planner), 5)
    mission = RecordedMission(scenario, policy, 0, 5, recording)
    write_mission(folder / f"mission-{policy}.json", mission)
    return mission
