"""Measure everything and print the tables: ``python -m benchmarks [environment|training|endurance]``.

``endurance`` takes a quarter of an hour and is measured only where it is named.
"""

from __future__ import annotations

import os
import sys

import torch

from benchmarks.endurance import endurance
from benchmarks.environment import stepping
from benchmarks.measure import report
from benchmarks.training import training
from uavaou.experiments.folder import describe_machine

PARTS = ["environment", "training"]


def main() -> None:
    chosen = sys.argv[1:] or PARTS
    if unknown_parts := set(chosen) - {*PARTS, "endurance"}:
        sys.exit(f"benchmarks: unknown part '{min(unknown_parts)}' (known: {', '.join(PARTS)}, endurance)")
    machine = describe_machine()
    print(
        f"{machine['processor']}, {os.cpu_count()} cores, torch {torch.__version__}, {torch.get_num_threads()} threads"
    )
    if "environment" in chosen:
        title = "Stepping 64 missions of `paper` (25 devices, 3 UAVs)"
        print("\n" + "\n".join(report(title, stepping(), "supersuit stage, 1 process")), flush=True)
    if "training" in chosen:
        title = "Training on `paper`, 64 missions, the published rollout, minibatch, epochs and networks"
        rates = training()
        stock = max((rate for rate in rates if rate.name.startswith("stock")), key=lambda rate: rate.median)
        print("\n" + "\n".join(report(title, rates, stock.name)))
    if "endurance" in chosen:
        print("\n10,000,000 slots of `quickstart`, MAPPO, one thread\n" + "\n".join(endurance().lines()))


if __name__ == "__main__":
    main()
