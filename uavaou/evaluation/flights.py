"""The table of flights: everything that is ever measured is rows of it, one for each mission that a policy flew.

A folder of results holds ``flights.csv.gz`` and, for what changes on the way, ``curves.csv.gz``: the missions of a
training in order, its validations, and the slots, devices and periods of its evaluation. Both are read with pandas.
AoU is in units of the slot length tau (``_slots``). docs/reference/files.md lists the columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from uavaou.arrays import Floats, Ints
from uavaou.csv_tables import NUMBER, TEXT, WHOLE, read_table, write_table

BOUND = "bound"  # the policy's name in the one row of a certified bound

KEY = {
    "job": TEXT,  # digest of the configuration that the row is of
    "policy": TEXT,  # variant, planner or run; bound for a bound
    "scenario": TEXT,  # flown
    "seed": WHOLE,  # of the training; planners and bounds have none
}
FLIGHTS = KEY | {
    "algorithm": TEXT,  # of a trained policy; of a bound its method
    "knows": TEXT,  # what the policy reads in flight
    "action": TEXT,  # greedy (the likeliest) or sampled
    "digest": TEXT,  # of a trained policy's weights
    "trained_on": TEXT,  # the scenario or family, named as its folder of results
    "how": TEXT,  # trained (on this very scenario), zero-shot or planner
    "suite": TEXT,  # that the mission is of
    "point": TEXT,  # of the suite
    "x": NUMBER,  # of the point, on the suite's axis
    "axis": TEXT,  # title of the suite's axis
    "scale": TEXT,  # of the axis: linear, log or category
    "joined": TEXT,  # yes or no: whether a line joins the points in a figure
    "mission_seed": WHOLE,  # of the mission
    "mean_aou_slots": NUMBER,  # mean over slots of the devices' summed age sums, in slots
    "communications": NUMBER,  # transfers that carry at least one update
    "devices_served": NUMBER,  # devices with at least one communication
    "violations": WHOLE,  # what the independent checker counts
    "flight_time_s": NUMBER,  # of all UAVs together
    "rejected_rate": NUMBER,  # selections of devices that are out of range
    "rejected_association": NUMBER,  # selections that another UAV with a larger rate wins
    "mean_aoi_slots": NUMBER,  # age of information, where a scenario asks for measures beside AoU
    "peak_aoi_slots": NUMBER,  # largest value of it, likewise
    "late_share": NUMBER,  # share of time in which it is above age_limit_s, likewise
    "slots": WHOLE,  # of the training; from here on the same in each of its rows
    "agent_steps": WHOLE,  # of the training: slots times UAVs
    "wall_s": NUMBER,  # of the training
    "cpu_s": NUMBER,  # CPU time of the training
    "best_slots": NUMBER,  # best mean AoU on the validation missions
    "commit": TEXT,  # of the code that trained or flew
    "processor": TEXT,  # that it ran on
}
CURVES = KEY | {
    "curve": TEXT,  # training, validation, "validation, sampled", slots, devices or periods
    "x": NUMBER,  # training slots, slot of a mission, device, or period in slots
    "wall_s": NUMBER,  # of the training so far
    "mean_aou_slots": NUMBER,  # mean of the missions at this point
    "low": NUMBER,  # lower end of its 95 % interval
    "high": NUMBER,  # upper end of its 95 % interval
    "communications": NUMBER,  # mean of the missions at this point
    "devices_served": NUMBER,  # mean of the missions at this point
}
TRAINING, VALIDATION, SAMPLED = "training", "validation", "validation, sampled"
SLOTS, DEVICES, PERIODS = "slots", "devices", "periods"
_FLOWN, _DRAWN = ("policy", "scenario", "mean_aou_slots"), ("policy", "scenario", "curve", "x")  # filled in each row


class PartKey(NamedTuple):
    """Which part of a study; only a training has a seed."""

    policy: str  # the variant, the planner, or BOUND
    scenario: str
    seed: int | None = None

    def __str__(self) -> str:
        seed = "" if self.seed is None else f", seed {self.seed}"
        return f"{self.policy} on {self.scenario}{seed}"


@dataclass
class Flights:
    """Rows of flights, and the curves that belong to them."""

    flights: pd.DataFrame  # columns of FLIGHTS
    curves: pd.DataFrame  # columns of CURVES

    @classmethod
    def of(cls, flights: Mapping[str, Any], curves: Sequence[Mapping[str, Any]] = (), **common: Any) -> Flights:
        """Rows from columns.

        Args:
            flights: column -> values of all rows, or one for all.
            curves: the same, of each curve.
            common: values that all rows have, flights and curves, where the latter have the column.
        """
        shared = {name: value for name, value in common.items() if name in CURVES}
        parts = [_frame({**curve, **shared}, CURVES) for curve in curves]
        return cls(_frame({**flights, **common}, FLIGHTS), _joined(parts, CURVES))

    @classmethod
    def joined(cls, tables: Iterable[Flights]) -> Flights:
        """The rows of several tables."""
        found = list(tables)
        return cls(_joined([one.flights for one in found], FLIGHTS), _joined([one.curves for one in found], CURVES))

    @classmethod
    def read(cls, folder: Path) -> Flights:
        """The tables of a folder; empty where it has none.

        Raises:
            InputError: a file is damaged; the message names it, and the line and column where there is one.
        """
        return cls(_read(folder / "flights.csv.gz", FLIGHTS, _FLOWN), _read(folder / "curves.csv.gz", CURVES, _DRAWN))

    def write(self, folder: Path) -> None:
        """Replace the tables of a folder, the flights last: curves without flights mean nothing.

        Raises:
            InputError: they cannot be written.
        """
        for name, frame in (("curves", self.curves), ("flights", self.flights)):
            write_table(folder / f"{name}.csv.gz", frame, ["x"])  # empty in the flights of studies, which always had it

    def where(self, **wanted: Any) -> Flights:
        """The rows with these values of columns that both tables have."""

        def chosen(frame: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
            for name, value in wanted.items():
                if name in columns:
                    frame = frame[frame[name].isna() if value is None else (frame[name] == value).fillna(False)]
            return frame

        return self.each(chosen)

    @cached_property
    def _places(self) -> list[dict[Any, Ints]]:
        """Where the rows of each policy on each scenario stand in both tables: a study has many."""
        return [dict(frame.groupby(["policy", "scenario"]).indices) for frame in (self.flights, self.curves)]

    def part(self, policy: str, scenario: str) -> Flights:
        """The rows of a policy on a scenario."""
        flights, curves = self._places
        none = np.empty(0, int)
        key = policy, scenario
        return Flights(self.flights.iloc[flights.get(key, none)], self.curves.iloc[curves.get(key, none)])

    def of_jobs(self, jobs: Iterable[str], kept: bool = True) -> Flights:
        """The rows of these jobs; without ``kept`` those of all others."""
        return self.each(lambda frame, _: frame[frame["job"].isin(list(jobs)) == kept])

    def with_values(self, **values: Any) -> Flights:
        """The same rows with other values."""

        def changed(frame: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
            here = {name: _column(value, columns[name]) for name, value in values.items() if name in columns}
            return frame.assign(**here)

        return self.each(changed)

    def each(self, change: Callable[[pd.DataFrame, Mapping[str, str]], pd.DataFrame]) -> Flights:
        """Both tables after a change, which is also given the types of their columns."""
        return Flights(change(self.flights, FLIGHTS), change(self.curves, CURVES))


def _column(value: Any, kind: str) -> Any:
    return pd.NA if value is None and kind != NUMBER else np.nan if value is None else value


def _frame(values: Mapping[str, Any], columns: Mapping[str, str]) -> pd.DataFrame:
    """A table of these columns; the others are empty."""
    sized = next((len(value) for value in values.values() if isinstance(value, list | tuple | np.ndarray)), 1)
    filled = {name: _column(values.get(name), kind) for name, kind in columns.items()}
    return pd.DataFrame(filled, index=range(sized)).astype(dict(columns))


def _joined(frames: Sequence[pd.DataFrame], columns: Mapping[str, str]) -> pd.DataFrame:
    some = [frame for frame in frames if len(frame)]
    return pd.concat(some, ignore_index=True) if some else _frame({"x": []}, columns)


def _read(path: Path, columns: Mapping[str, str], needed: Sequence[str]) -> pd.DataFrame:
    there = path.exists() or path.is_symlink()
    return read_table(path, columns, needed) if there else _frame({"x": []}, columns)


def column(frame: pd.DataFrame, name: str) -> Floats:
    """A column as numbers, (R,); empty cells are nan."""
    values: Floats = frame[name].astype(NUMBER).to_numpy()
    return values
