"""Size and latency of exported policies: ``python -m benchmarks.on_board RUN [--scenario MAP]``.

The policy is exported and flies a mission as on board, one decision of each UAV in each slot. Times are CPU seconds of
a decision of the first UAV, and of its network alone.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from uavaou import World
from uavaou.onboard.export import export_onnx
from uavaou.onboard.runner import Pilot
from uavaou.runs.policy import load_run

DECISIONS = 400  # timed, after some that are not
UNTIMED = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", help="a run folder or a released policy")
    parser.add_argument("--scenario", help="the map to fly (default: the one that it was trained on)")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        exported = export_onnx(chosen.run, Path(place), chosen.scenario)
        world = World(load_run(chosen.run, chosen.scenario).views.scenario, seed=10_000)
        network, decision = latencies(world, [Pilot(place, uav) for uav in range(world.scenario.uavs)])
        size = (Path(place) / "policy.onnx").stat().st_size
    print(f"same action: {exported.same:,} of {exported.rows:,} rows; policy.onnx: {size / 1000:.0f} kB")
    for name, taken in (("network", network), ("decision", decision)):
        median, most = np.percentile(taken, [50, 99]) * 1000
        print(f"{name}: {median:.2f} ms (99th percentile {most:.2f})")


def latencies(world: World, pilots: list[Pilot]) -> tuple[list[float], list[float]]:
    """CPU seconds of the first UAV's network, and of its whole decisions, in one mission."""
    network: list[float] = []
    decision: list[float] = []
    pilots[0].session = Timed(pilots[0].session, network)
    while not world.done and len(decision) < UNTIMED + DECISIONS:
        at, in_range = world.positions[0], world.in_range[0]  # (U, 2) m, (U, I)
        started = time.process_time()
        decided = [pilots[0].decide(at[0], in_range[0], at[1:])]
        decision.append(time.process_time() - started)
        decided += [pilot.decide(at[u], in_range[u], np.delete(at, u, axis=0)) for u, pilot in enumerate(pilots) if u]
        world.step(np.array([[move for move, _, _ in decided]]), np.array([[chosen for _, _, chosen in decided]]))
        assert world.stepped is not None
        for pilot in pilots:
            pilot.end_slot(world.stepped.association.collected_by[0])
    return network[UNTIMED:], decision[UNTIMED:]


class Timed:
    """A session that notes the CPU seconds of each run."""

    def __init__(self, session: Any, taken: list[float]) -> None:
        self.session, self.taken = session, taken

    def run(self, names: None, rows: dict[str, Any]) -> Any:
        """Run the graph, as onnxruntime's session does."""
        started = time.process_time()
        outputs = self.session.run(names, rows)
        self.taken.append(time.process_time() - started)
        return outputs


if __name__ == "__main__":
    main()
