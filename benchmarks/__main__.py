"""Measure everything, print the tables, write ``results/benchmarks``: ``python -m benchmarks [PART ...] [--quick]``."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import torch

from benchmarks.environment import scaling, stepping
from benchmarks.measure import COLUMNS, Measurement, report, write_rows
from benchmarks.operations import operations
from benchmarks.training import STOCK, memory, networks, parts, training
from uavaou.runs.machine import describe_machine

Part = Callable[[], list[Measurement]]
PARTS: dict[str, Part] = {
    "stepping": stepping, "scaling": scaling, "parts": parts, "training": training, "networks": networks,
    "memory": memory, "operations": operations,
}  # fmt: skip
QUICK: dict[str, Part] = {
    "stepping": lambda: stepping(slots=20, repeats=1),
    "scaling": lambda: scaling(
        batches=(1, 64, 1024), fleets=(1, 3, 8), devices=(5, 25, 250), repeats=1, agent_steps=10_000
    ),
    "parts": lambda: parts(repeats=1, rollout_slots=25),
    "training": lambda: training(repeats=1, rollout_slots=25),
    "networks": lambda: networks(repeats=1, rollout_slots=5),
    "memory": lambda: memory(rollouts=2),
    "operations": lambda: operations(slots=20, repeats=1),
}
REFERENCES = ("supersuit stage, 1 process",)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("part", nargs="*", choices=[[], *PARTS], help="what is measured (default: everything)")
    parser.add_argument("--quick", action="store_true", help="small sizes, once: to see that it runs")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    machine = describe_machine()
    print(f"{machine['processor']}, {os.cpu_count()} cores, torch {torch.__version__}, {machine['threads']} threads")
    for name in arguments.part or PARTS:
        measured = (QUICK if arguments.quick else PARTS)[name]()
        for title, table in groupby(measured, key=lambda m: m.table):
            rows = list(table)
            print("\n" + "\n".join(report(title, rows, _reference(rows))), flush=True)
        if not arguments.quick:
            write(arguments.out / f"{name}.csv", measured)
            (arguments.out / "machine.json").write_text(json.dumps(machine, indent=1) + "\n", encoding="utf-8")


def _reference(rows: list[Measurement]) -> str | None:
    """What the table's ratios are to: SuperSuit's stage; the stock pipeline with its best process count."""
    stock = [row for row in rows if row.name.startswith(STOCK)]
    if stock:
        return max(stock, key=lambda row: row.median).name
    return next((row.name for row in rows if row.name in REFERENCES), None)


def write(path: Path, measured: list[Measurement]) -> None:
    """Write the figures as CSV."""
    rows = [(m.table, m.name, m.unit, m.median, m.lowest, m.highest) for m in measured]
    write_rows(path, COLUMNS, rows)


if __name__ == "__main__":
    main()
