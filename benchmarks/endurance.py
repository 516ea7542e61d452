"""A long training of ``quickstart``, ``python -m benchmarks.endurance``: does memory grow, does it slow down?

The machine may be busy with other things, so the rate is that of CPU time, not of wall-clock.
"""

from __future__ import annotations

import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from uavaou import Scenario
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import train

PARTS = 40  # of the training, at the end of each of which is measured
_WARM = PARTS // 10  # parts in which caches fill; not counted
_PAGES = resource.getpagesize() / 2**20  # MiB


@dataclass(frozen=True)
class Endurance:
    """What was measured at the end of each part."""

    slots: np.ndarray  # (PARTS,)
    memory_mib: np.ndarray  # (PARTS,) resident
    slots_a_cpu_second: np.ndarray  # (PARTS,)

    def lines(self) -> list[str]:
        """The table, and the two figures that matter."""
        counted = slice(_WARM, None)
        millions, memory = self.slots[counted] / 1e6, self.memory_mib[counted]
        slope, start = np.polyfit(millions, memory, 1)
        noise = float(np.std(memory - (slope * millions + start)))
        tenth = max(len(memory) // 5, 1)
        first, last = (
            float(np.median(part))
            for part in (self.slots_a_cpu_second[counted][:tenth], self.slots_a_cpu_second[-tenth:])
        )
        lines = [f"{'slots':>12}  {'memory, MiB':>11}  slots a CPU second"]
        lines += [
            f"{s:>12,.0f}  {m:>11.1f}  {r:,.0f}"
            for s, m, r in zip(self.slots, self.memory_mib, self.slots_a_cpu_second, strict=True)
        ]
        lines.append(f"memory: {slope:+.3f} MiB a million slots, residuals {noise:.2f} MiB")
        lines.append(
            f"rate: {first:,.0f} slots a CPU second at the start, {last:,.0f} at the end ({last / first - 1:+.1%})"
        )
        return lines


def endurance(slots: int = 10_000_000) -> Endurance:
    """Train MAPPO for ``slots`` with one thread and measure on the way."""
    torch.set_num_threads(1)
    scenario = Scenario.load("quickstart")
    algorithm = load_config("mappo", {"slots": slots, "evaluate_every_slots": slots // PARTS})
    measured: list[tuple[int, float, float]] = []
    every = slots // PARTS

    def watch(status: TrainingStatus) -> None:
        if status.slots >= every * (len(measured) + 1):
            measured.append((status.slots, _resident(), time.process_time()))

    began = time.process_time()
    with tempfile.TemporaryDirectory() as place:
        train(RunConfig(scenario, algorithm, seed=0), RunFolder(Path(place) / "run"), after_update=watch)
    done, memory, cpu = np.array(measured).T
    rates = np.diff(done, prepend=0) / np.diff(cpu, prepend=began)
    return Endurance(done, memory, rates)


def _resident() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGES


if __name__ == "__main__":
    print("10,000,000 slots of `quickstart`, MAPPO, one thread\n" + "\n".join(endurance().lines()))
