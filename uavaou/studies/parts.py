"""The parts of a study: trainings, planners, certified bounds, and the plans that some planners start from."""

from __future__ import annotations

from typing import NamedTuple

from uavaou.csv_tables import CsvTable

BOUND = "bound"
PLAN = "plan"
ANNEALED = ("anneal", "rolling")  # planners that start from an annealed plan
PLANNED = (*ANNEALED, "exact")  # planners whose results depend on planning_seconds
NO_SEED = -1  # of planners, in a column of seeds


class PartKey(NamedTuple):
    """Which part of a study; only a training has a seed."""

    variant: str  # or the planner's name, BOUND or PLAN
    scenario: str
    seed: int | None = None

    def __str__(self) -> str:
        seed = "" if self.seed is None else f", seed {self.seed}"
        return f"{self.variant} on {self.scenario}{seed}"


def part_keys(table: CsvTable) -> list[PartKey]:
    """The part that each row of a table belongs to; rows without a variant are bounds.

    Raises:
        InputError: a seed is not a whole number from 0 on.
    """
    if "variant" not in table.columns:
        return [PartKey(BOUND, scenario) for scenario in table.text("scenario")]
    seeds = table.integers("seed", missing=NO_SEED).tolist()
    for row, cell in enumerate(table.text("seed")):
        if seeds[row] < 0 and cell.strip():
            raise table.error(row, "seed", "a whole number from 0 on")
    rows = zip(table.text("variant"), table.text("scenario"), seeds, strict=True)
    return [PartKey(variant, scenario, None if seed == NO_SEED else seed) for variant, scenario, seed in rows]
