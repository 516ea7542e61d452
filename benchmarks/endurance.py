"""Does memory grow, does it slow down? ``python -m benchmarks.endurance [training|family|eval|fly] [AMOUNT]``.

``training`` trains 10,000,000 slots of ``quickstart``, ``family`` as many of the family ``any``. ``eval`` and ``fly``
give the same command 1,000 times in one process, each time with another mission.

The machine may be busy with other things, so the rate is that of CPU time, not of wall-clock.
"""

from __future__ import annotations

import contextlib
import io
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uavaou import Family, Scenario
from uavaou.algorithms.registry import load_config
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.recorder import TrainingStatus
from uavaou.runs.train import train
from uavaou.threads import use_threads
from uavaou_cli.main import main as command_line

PARTS = 40  # at the end of each of which is measured
_PAGES = resource.getpagesize() / 2**20  # MiB
_FAMILY = {"network": "set", "observation": "shared", "worlds": 16, "evaluation_missions": 16}
COMMANDS = {
    "eval": "eval --scenario tiny --policy any-map --policy greedy --episodes 1 --seed {seed} --out {place}/e.csv",
    "fly": "fly tiny --seed {seed} --out {place}/{seed}",
}
AMOUNTS = {"training": 10_000_000, "family": 10_000_000, "eval": 1000, "fly": 1000}


@dataclass
class Endurance:
    """What was measured at the end of each part."""

    unit: str  # what is done: slots or missions
    done: list[int] = field(default_factory=list)
    memory_mib: list[float] = field(default_factory=list)  # resident
    cpu_s: list[float] = field(default_factory=list)  # since the beginning
    _began: float = field(default_factory=time.process_time)

    def measure(self, done: int) -> None:
        """Add a row, so much is done, and print it: the command takes hours."""
        self.done.append(done)
        self.memory_mib.append(int(Path("/proc/self/statm").read_text().split()[1]) * _PAGES)
        self.cpu_s.append(time.process_time() - self._began)
        since = self.cpu_s[-1] - (self.cpu_s[-2] if len(self.cpu_s) > 1 else 0)
        rate = (done - (self.done[-2] if len(self.done) > 1 else 0)) / since
        print(f"{done:>12,.0f}  {self.memory_mib[-1]:>11.1f}  {rate:,.1f}", file=sys.__stdout__, flush=True)

    def lines(self) -> list[str]:
        """The two figures that matter, without the first tenth, in which caches fill."""
        done, memory = np.array(self.done, dtype=float), np.array(self.memory_mib)  # (PARTS,) each
        rates = np.diff(done, prepend=0) / np.diff(self.cpu_s, prepend=0)  # (PARTS,)
        counted = slice(max(len(done) // 10, 1), None)
        many, million = ("a million slots", 1e6) if self.unit == "slots" else (f"a thousand {self.unit}", 1e3)
        slope, start = np.polyfit(done[counted] / million, memory[counted], 1)
        noise = float(np.std(memory[counted] - (slope * done[counted] / million + start)))
        fifth = max(len(rates[counted]) // 5, 1)
        first, last = float(np.median(rates[counted][:fifth])), float(np.median(rates[-fifth:]))
        memory_line = f"memory: {slope:+.3f} MiB {many}, residuals {noise:.2f} MiB"
        change = f"{first:,.1f} {self.unit} a CPU second at the start, {last:,.1f} at the end ({last / first - 1:+.1%})"
        return [memory_line, f"rate: {change}"]


def trained(slots: int, family: bool = False, parts: int = PARTS) -> Endurance:
    """Train MAPPO for ``slots`` with one thread and measure on the way."""
    use_threads(1)
    config = RunConfig(
        Scenario.load("quickstart"), load_config("mappo", {"slots": slots, "evaluate_every_slots": slots // parts})
    )
    if family:
        drawn = Family.load("any")
        settings = {"slots": slots, "evaluate_every_slots": max(slots // 5, 1), **_FAMILY}
        config = RunConfig(drawn.base, load_config("mappo-paper", settings), 0, drawn)
    measured = Endurance("slots")

    def watch(status: TrainingStatus) -> None:
        if status.slots >= slots // parts * (len(measured.done) + 1):
            measured.measure(status.slots)

    with tempfile.TemporaryDirectory() as place:
        train(config, RunFolder(Path(place) / "run"), after_update=watch)
    return measured


def repeated(name: str, times: int) -> Endurance:
    """Give a command ``times`` times in this process, each time with another mission."""
    use_threads(1)
    measured = Endurance("missions")
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        for mission in range(times):
            words = COMMANDS[name].format(seed=10_000 + mission, place=os.fspath(place)).split()
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                code = command_line([*words, "--quiet"])
            if code:
                raise RuntimeError(f"uavaou {' '.join(words)}: exit code {code}")
            if mission + 1 >= times / PARTS * (len(measured.done) + 1):
                measured.measure(mission + 1)
    return measured


def main() -> None:
    what = sys.argv[1] if len(sys.argv) > 1 else "training"
    amount = int(sys.argv[2]) if len(sys.argv) > 2 else AMOUNTS[what]
    unit = "missions" if what in COMMANDS else "slots"
    print(f"{what}: {amount:,} {unit}, one thread\n{unit:>12}  {'memory, MiB':>11}  {unit} a CPU second", flush=True)
    measured = repeated(what, amount) if what in COMMANDS else trained(amount, what == "family")
    print("\n".join(measured.lines()))


if __name__ == "__main__":
    main()
