"""A study's results, ``results/studies/<name>/``: its settings, and its rows of the table of flights.

Reading needs neither torch nor the run folders.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from uavaou.algorithms.registry import published_as
from uavaou.arrays import Floats
from uavaou.errors import InputError, command_line, nearest_path
from uavaou.evaluation.flights import BOUND, TRAINING, Flights, PartKey, column
from uavaou.files import PathIn, folder_name
from uavaou.runs.lock import LOCK
from uavaou.scenario import Scenario
from uavaou.statistics import Interval, interval_over_missions
from uavaou.zoo import read_yaml_mapping, zoo_names

Curve = dict[str, Floats]  # column -> (X,)


class NothingYetError(InputError):
    """A study that has only begun: nothing is wrong with it."""


@dataclass(frozen=True)
class StudyFolder:
    """The paths of one study's results, ``<out>/studies/<name>/``."""

    path: Path

    @classmethod
    def of(cls, out: Path, name: str) -> StudyFolder:
        """The folder of a study below ``out``, the folder of all results."""
        return cls(out / "studies" / name)

    study = PathIn("study.yaml")  # the study as resolved
    lock = PathIn(LOCK)  # held by the process that runs the study
    state = PathIn(".state.json")  # what is in progress, valid while the lock is held, and what has failed

    def best(self, key: PartKey) -> Path:
        """Where the best run of a variant on a scenario is kept."""
        return self.path / "best" / folder_name(key.scenario) / folder_name(key.policy) / f"seed-{key.seed}"


@dataclass(frozen=True)
class StudyResults:
    """What a study has measured: trainings, planners (which have no seeds) and bounds.

    A page asks for the same again and again, so what follows from all rows is computed once.
    """

    folder: StudyFolder
    settings: dict[str, Any]  # the content of ``study.yaml``, every setting of every run
    table: Flights

    @property
    def name(self) -> str:
        """The study's name, which is its folder's."""
        return self.folder.path.name

    @property
    def argument(self) -> str:
        """The study on a command line: the name of a shipped one, else the name of its file."""
        return command_line([self.name if self.name in zoo_names("studies") else f"{self.name}.yaml"])

    @cached_property
    def flights(self) -> pd.DataFrame:
        """The flights without bounds, which nobody flew."""
        return self.table.flights[self.table.flights["policy"] != BOUND]

    @property
    def parts(self) -> list[PartKey]:
        """Everything that has been measured."""
        keys = self.table.flights[["policy", "scenario", "seed"]].drop_duplicates()
        return [PartKey(policy, place, None if pd.isna(seed) else int(seed)) for policy, place, seed in keys.values]

    @cached_property
    def algorithms(self) -> dict[str, str]:
        """Variant -> algorithm of the learned variants, in the study's order."""
        stated = _mapping(self.settings.get("variants"))
        learned = set(self.flights.loc[self.flights["seed"].notna(), "policy"])
        learned |= set(self.table.curves.loc[self.table.curves["curve"] == TRAINING, "policy"])
        order = [*(name for name in stated if name in learned), *sorted(learned - stated.keys())]
        return {name: str(_mapping(stated.get(name)).get("name", name)) for name in order}

    @cached_property
    def planners(self) -> tuple[str, ...]:
        """The planners and released policies evaluated."""
        return tuple(self.flights.loc[self.flights["seed"].isna(), "policy"].unique())

    @cached_property
    def bounds(self) -> dict[str, float]:
        """Scenario -> certified lower bound of the mean AoU, slots."""
        rows = self.table.where(policy=BOUND).flights
        return dict(zip(rows["scenario"], rows["mean_aou_slots"], strict=True))

    def published(self, variant: str) -> str:
        """The name under which the settings of a variant are published: ``mappo`` from nothing is ``mappo-paper``."""
        stated = _mapping(_mapping(self.settings.get("variants")).get(variant))
        return published_as(variant, str(stated.get("network", "")))

    @property
    def reference(self) -> str | None:
        """The variant that the report compares the others with."""
        reference = self.settings.get("reference")
        return reference if isinstance(reference, str) else None

    @property
    def drawn(self) -> list[str]:
        """The learned variants that figures 3 to 8 and the recorded missions show."""
        stated = self.settings.get("drawn")
        return [name for name in self.algorithms if not isinstance(stated, list) or name in stated]

    @cached_property
    def scenarios(self) -> dict[str, dict[str, Any]]:
        """Name -> fields of the scenarios with trained or evaluated parts, in the study's order; no points of suites.

        Raises:
            InputError: ``study.yaml`` lacks one of them, or a field that figures are labelled with.
        """
        stated = _mapping(self.settings.get("scenarios"))
        apart = self.flights["suite"].isna()
        found = {*self.flights.loc[apart, "scenario"].unique(), *self.table.curves["scenario"].unique()}
        found -= {*self.flights.loc[~apart, "scenario"].unique()}
        for name in sorted(found):
            if name.startswith(".") or set(name) & set("/\\\0"):  # figures go to folders of these names
                raise InputError(f"{self.folder.path}: scenario {name!r} cannot name a folder")
            for label in ("slots", "slot_length_s", "devices"):
                value = _mapping(stated.get(name)).get(label)
                if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                    where = f"{self.folder.study}: scenarios.{name}.{label}"
                    raise InputError(f"{where} = {value!r}: expected a number above 0")
        return {name: fields for name, fields in stated.items() if name in found}

    def mission_s(self, scenario: str) -> float:
        """The length of a mission, K tau, in s: minus its reward where the mean AoU is one slot."""
        return float(self.scenarios[scenario]["slots"] * self.scenarios[scenario]["slot_length_s"])

    def periods(self, scenario: str) -> Floats:
        """The generation period of each device of a scenario with one layout, (I,) slots."""
        layout = Scenario.from_dict(self.scenarios[scenario], str(self.folder.study)).draw_layout()
        return layout.update_period.astype(np.float64)

    def knows(self, policy: str) -> str:
        """What a policy reads in flight; empty where the flights do not say."""
        told = self.flights.loc[self.flights["policy"] == policy, "knows"].dropna()
        return str(told.iloc[0]) if len(told) else ""

    def trainings(self, policy: str, scenario: str) -> pd.DataFrame:
        """A row for each training, by seed: what is the same in all of its rows, and the means of its missions."""
        rows = self.table.part(policy, scenario).flights
        rows = rows[rows["seed"].notna()]
        same = ["algorithm", "slots", "agent_steps", "wall_s", "cpu_s", "best_slots", "commit", "processor"]
        how = dict.fromkeys(same, "first") | dict.fromkeys(
            ("mean_aou_slots", "communications", "devices_served"), "mean"
        )
        return rows.groupby("seed").agg(how | {"violations": "sum"}).reset_index()

    def curves(self, curve: str, policy: str, scenario: str) -> list[Curve]:
        """A curve of each training of a variant, by seed; of a planner its one."""
        rows = self.table.part(policy, scenario).where(curve=curve).curves
        each = [rows] if rows["seed"].isna().all() else [own for _, own in rows.groupby("seed")]
        return [{name: column(own, name) for name in _NUMBERS} for own in each if len(own)]

    def stack(self, policy: str, scenario: str, name: str = "mean_aou_slots", curve: str | None = None) -> Floats:
        """A column of the missions, or of a curve, of all seeds, (S, n); (0, 0) where there are none.

        Raises:
            InputError: the seeds have different numbers of rows.
        """
        if curve is not None:
            columns = [own[name] for own in self.curves(curve, policy, scenario)]
        else:
            rows = self.table.part(policy, scenario).flights
            rows = rows.assign(seed=rows["seed"].fillna(-1))
            columns = [column(own, name) for _, own in rows.groupby("seed")]
        if len({len(values) for values in columns}) > 1:
            raise InputError(
                f"{self.folder.path}: the seeds of '{policy}' on '{scenario}' have different numbers of rows"
            )
        return np.stack(columns) if columns else np.empty((0, 0))

    def missions(
        self, policy: str, name: str = "mean_aou_slots", scenarios: Iterable[str] | None = None
    ) -> dict[str, Floats]:
        """A metric of every evaluated mission, scenario -> (S, M); without the scenarios that have none."""
        wanted = self.scenarios if scenarios is None else scenarios
        found = {scenario: self.stack(policy, scenario, name) for scenario in wanted}
        return {scenario: values for scenario, values in found.items() if values.size}

    def on_several_processors(self, scenario: str) -> bool:
        """Whether the trainings on a scenario ran on several processors, or it was not recorded on which."""
        rows = self.table.where(scenario=scenario).flights
        found = set(rows.loc[rows["seed"].notna(), "processor"].fillna(""))
        return len(found) > 1 or "" in found

    def mean(self, key: PartKey) -> Interval:
        """The mean AoU of a part in slots with its interval over missions; ends are nan where unknown."""
        if key.policy == BOUND:
            return Interval(self.bounds[key.scenario], np.nan, np.nan)
        rows = self.table.part(key.policy, key.scenario).where(seed=key.seed).flights
        return interval_over_missions(column(rows, "mean_aou_slots"))

    def require_evaluated(self) -> StudyResults:
        """These results.

        Raises:
            NothingYetError: no part has been evaluated.
            InputError: as :attr:`scenarios`.
        """
        if not len(self.flights):
            raise NothingYetError(f"'{self.folder.path}' holds no evaluated run yet")
        _ = self.scenarios
        return self


_NUMBERS = ("x", "wall_s", "mean_aou_slots", "low", "high", "communications", "devices_served")


def read_study(folder: str | Path) -> StudyResults:
    """Read ``results/studies/<name>``.

    Raises:
        InputError: a file is missing or damaged; the message names the file, and the line and column where there is
            one.

    Examples:
        >>> from uavaou import read_study
        >>> read_study("results/studies/default").name
        'default'
    """
    place = StudyFolder(Path(folder))
    if not place.study.is_file():
        problem = "holds no study.yaml" if place.path.exists() else "does not exist"
        expected = nearest_path(place.path) or ": expected the results of a study, such as results/studies/paper"
        raise InputError(f"'{folder}' {problem}{expected}")
    return read_begun(place)


def read_begun(folder: StudyFolder) -> StudyResults:
    """What a study has measured so far; empty results where it has not begun.

    Raises:
        InputError: a file is damaged.
    """
    settings = read_yaml_mapping(folder.study) if folder.study.is_file() else {}
    return StudyResults(folder, settings, Flights.read(folder.path))


def study_folders(results: Path) -> list[Path]:
    """The studies under ``results/studies``; ``paper`` first, then by name.

    Raises:
        InputError: there is none.
    """
    found = [path.parent for path in (results / "studies").glob("*/study.yaml")]
    if not found:
        raise InputError(
            f"'{results / 'studies'}' holds no study to draw: 'uavaou study run paper' makes one; "
            "a single training's figures: uavaou plot figures RUN"
        )
    return sorted(found, key=lambda path: (path.name != "paper", path.name))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
