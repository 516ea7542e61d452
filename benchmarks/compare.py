"""This project beside others on one task and machine: ``python -m benchmarks.compare [PART ...]``.

Everything is CPU time of one process in one thread, with the contestants taking turns: other work on the machine hardly
changes it. A contestant that is not installed is left out, and the committed row of it stays. To have all:

    pip install benchmarl vmas gradysim torch_geometric
    git clone https://github.com/NU-IDEAS-Lab/patrolling_zoo
    git clone https://github.com/uoe-agents/epymarl
    git clone https://github.com/theilem/uavSim
    export PYTHONPATH=patrolling_zoo

``installs`` asks pip what it would install into an empty environment; it installs nothing.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3 import PPO

from benchmarks.measure import COLUMNS, Measurement, exactly, kept_rows, report, side_by_side, write_rows
from uavaou import LocalRows, Scenario, flatten, uavaou_v0
from uavaou.algorithms.registry import load_config, make_model

TABLE = Path(__file__).resolve().parents[1] / "results" / "benchmarks" / "compare.csv"
OWN = "uavaou"
STEPPING, TRAINING, SIMULATING, INSTALLS = "stepping", "training", "simulating", "installs"
SLOTS, MISSIONS, HIDDEN, BATCH_ROWS, EPOCHS = 20, 64, [128, 128], 768, 5
# What pip is asked for; files of requirements are those of clones in the working folder.
REQUIREMENTS = {
    OWN: [str(TABLE.parents[2])],
    "BenchMARL": ["benchmarl"],
    "rl_zoo3": ["rl-zoo3"],
    "GrADyS-SIM NG": ["gradysim"],
    "EPyMARL": ["-r", "epymarl/requirements.txt"],
    "MARLlib": ["marllib"],
    "uavSim": ["-r", "uavSim/requirements.txt"],
}

Contestants = dict[str, tuple[Callable[[], None], int]]


def stepping(repeats: int = 3) -> list[Measurement]:
    """Agent steps with random actions, of three agents: one environment of PettingZoo, and many as one."""
    contestants: Contestants = {
        f"{OWN}, PettingZoo, one mission": (_parallel(uavaou_v0.parallel_env("paper", collection="auto"), 300), 900),
    }
    many = {MISSIONS: SLOTS, 16 * MISSIONS: SLOTS // 4}  # missions -> slots
    for missions, slots in many.items():
        contestants[f"{OWN}, rows of {missions} missions"] = (_rows(missions, slots), slots * missions * 3)
    if find_spec("patrolling_zoo"):  # it makes a graph of PyTorch Geometric of each observation
        import patrolling_zoo
        from patrolling_zoo.patrolling_zoo_v0 import PatrolGraph, parallel_env

        graph = Path(patrolling_zoo.__file__).parent / "env" / "cumberland.graph"
        env = parallel_env(PatrolGraph(str(graph)), 3, max_cycles=10_000)
        contestants["patrolling_zoo, PettingZoo, one mission"] = (_parallel(env, 100), 300)
    if find_spec("vmas"):
        for missions, slots in many.items():
            contestants[f"VMAS `sampling`, {missions} missions"] = (_vmas(missions, slots), slots * missions * 3)
    return side_by_side(STEPPING, contestants, repeats, time.process_time)


def _parallel(env: Any, slots: int) -> Callable[[], None]:
    """One mission of a parallel environment from its beginning, with actions drawn beforehand."""
    env.reset(seed=0)
    for agent in env.possible_agents:
        env.action_space(agent).seed(0)
    actions = [{agent: env.action_space(agent).sample() for agent in env.possible_agents} for _ in range(slots)]

    def play() -> None:
        env.reset(seed=0)
        for action in actions:
            env.step(action)

    return play


def _rows(missions: int, slots: int) -> Callable[[], None]:
    env = flatten("paper", missions=missions, collection="auto")
    env.reset()
    actions = np.random.default_rng(0).integers(0, 5, (slots, env.num_envs))

    def play() -> None:
        for action in actions:
            env.step(action)

    return play


def _vmas(missions: int, slots: int) -> Callable[[], None]:
    import vmas

    env = vmas.make_env("sampling", num_envs=missions, device="cpu", continuous_actions=False, seed=0, n_agents=3)
    actions = th.randint(0, 5, (slots, 3, missions, 1))

    def play() -> None:
        env.reset()
        for action in actions:
            env.step(list(action))

    return play


def training(repeats: int = 2) -> list[Measurement]:
    """Agent steps with updates on ``paper``, every device in range is collected: one rollout, 128-128, five epochs."""
    rows = SLOTS * MISSIONS * 3
    work = {"missions": MISSIONS, "rollout_slots": SLOTS, "batch_rows": BATCH_ROWS, "epochs": EPOCHS, "hidden": HIDDEN}
    config = load_config("mappo-paper", work | {"collection": "auto", "critic_input": "global"})
    own = make_model(config, flatten("paper", missions=MISSIONS, collection="auto"), seed=0, device="cpu")
    stock = PPO(
        "MlpPolicy",
        LocalRows(flatten("paper", missions=MISSIONS, collection="auto")),
        n_steps=SLOTS,
        batch_size=BATCH_ROWS,
        n_epochs=EPOCHS,
        policy_kwargs={"net_arch": {"pi": HIDDEN, "vf": HIDDEN}},
        device="cpu",
    )
    contestants: Contestants = {f"{OWN}, MAPPO": (_learn(own, rows), rows)}
    contestants["SB3's PPO, which rl_zoo3 trains, on the rows"] = (_learn(stock, rows), rows)
    if find_spec("benchmarl"):
        contestants["BenchMARL, MAPPO on the PettingZoo environment"] = (_benchmarl(rows, repeats + 1), rows)
    return side_by_side(TRAINING, contestants, repeats, time.process_time)


def _learn(model: Any, rows: int) -> Callable[[], None]:
    def learn() -> None:
        model.learn(rows, reset_num_timesteps=model.num_timesteps == 0)

    return learn


def _benchmarl(rows: int, runs: int) -> Callable[[], None]:
    """BenchMARL's MAPPO: the same rows a rollout, minibatches, epochs and widths; its own loop otherwise."""
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models import MlpConfig

    from benchmarks.benchmarl_task import Paper

    settings = ExperimentConfig.get_from_yaml()
    settings.on_policy_collected_frames_per_batch = rows // 3
    settings.on_policy_n_envs_per_worker = 1
    settings.on_policy_n_minibatch_iters = EPOCHS
    settings.on_policy_minibatch_size = BATCH_ROWS // 3
    settings.max_n_iters, settings.max_n_frames = 1, None
    settings.evaluation, settings.render, settings.loggers, settings.create_json = False, False, [], False
    settings.save_folder = tempfile.mkdtemp()
    network = MlpConfig(num_cells=HIDDEN, layer_class=th.nn.Linear, activation_class=th.nn.Tanh)

    def made() -> Experiment:
        algorithm = MappoConfig.get_from_yaml()
        return Experiment(Paper("paper", {}), algorithm, network, seed=0, config=settings, critic_model_config=network)

    waiting = [made() for _ in range(runs)]  # what it takes to make one does not count
    return lambda: waiting.pop().run()


def simulating(repeats: int = 2) -> list[Measurement]:
    """Seconds of a mission of 3 UAVs and 25 devices on a square kilometre for a second of CPU time."""
    paper = Scenario.load("paper")
    slots = 10
    seconds = round(slots * paper.slot_length_s)
    contestants: Contestants = {
        f"{OWN}, PettingZoo, one mission": (
            _parallel(uavaou_v0.parallel_env(paper, collection="auto"), slots),
            seconds,
        )
    }
    if find_spec("gradysim"):
        contestants["GrADyS-SIM NG, messages once a second, motion at 100 Hz"] = (_gradys(paper, seconds), seconds)
    measured = side_by_side(SIMULATING, contestants, repeats, time.process_time)
    return [Measurement(m.table, m.name, "mission s/s", m.median, m.lowest, m.highest) for m in measured]


def _gradys(scenario: Scenario, seconds: int) -> Callable[[], None]:
    """UAVs fly to and fro and ask devices within 300 m for their updates, once a second."""
    from gradysim.protocol.interface import IProtocol
    from gradysim.protocol.messages.communication import BroadcastMessageCommand, SendMessageCommand
    from gradysim.protocol.plugin.mission_mobility import (
        LoopMission,
        MissionMobilityConfiguration,
        MissionMobilityPlugin,
    )
    from gradysim.simulator.handler.communication import CommunicationHandler, CommunicationMedium
    from gradysim.simulator.handler.mobility import MobilityHandler
    from gradysim.simulator.handler.timer import TimerHandler
    from gradysim.simulator.simulation import SimulationBuilder, SimulationConfiguration

    class Silent(IProtocol):
        def initialize(self) -> None: ...
        def handle_timer(self, timer: str) -> None: ...
        def handle_packet(self, message: str) -> None: ...
        def handle_telemetry(self, telemetry: Any) -> None: ...
        def finish(self) -> None: ...

    class Device(Silent):
        def handle_packet(self, message: str) -> None:
            asked = json.loads(message)
            if "uav" in asked:
                answer = json.dumps({"device": self.provider.get_id(), "at": self.provider.current_time()})
                self.provider.send_communication_command(SendMessageCommand(answer, asked["uav"]))

    class Uav(Silent):
        def initialize(self) -> None:
            self.newest: dict[int, float] = {}
            plan = MissionMobilityConfiguration(loop_mission=LoopMission.REVERSE)
            self.flies = MissionMobilityPlugin(self, plan)
            self.flies.start_mission([(0, 0, 90), (1000, 1000, 90)])
            self.handle_timer("")

        def handle_timer(self, timer: str) -> None:
            asks = json.dumps({"uav": self.provider.get_id()})
            self.provider.send_communication_command(BroadcastMessageCommand(asks))
            self.provider.schedule_timer("", self.provider.current_time() + 1)

        def handle_packet(self, message: str) -> None:
            told = json.loads(message)
            if "device" in told:
                self.newest[told["device"]] = told["at"]

    places = np.random.default_rng(0).uniform(0, 1000, (scenario.devices, 2))

    def play() -> None:
        builder = SimulationBuilder(SimulationConfiguration(duration=seconds, execution_logging=False))
        for x, y in places:
            builder.add_node(Device, (float(x), float(y), 0.0))
        for x, y in scenario.cds_m:
            builder.add_node(Uav, (x, y, 90.0))
        builder.add_handler(TimerHandler())
        builder.add_handler(CommunicationHandler(CommunicationMedium(transmission_range=300)))
        builder.add_handler(MobilityHandler())
        builder.build().start_simulation()

    return play


def installs() -> list[Measurement]:
    """How many packages pip would put into an empty environment; nan where it cannot."""
    measured = []
    for name, wanted in REQUIREMENTS.items():
        if wanted[0] == "-r" and not Path(wanted[1]).is_file():
            continue
        command = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--dry-run",
            "--ignore-installed",
            "--quiet",
            "--report",
            "-",
        ]
        asked = subprocess.run([*command, *wanted], capture_output=True, text=True, check=False)
        packages = len(json.loads(asked.stdout)["install"]) if asked.returncode == 0 else float("nan")
        measured.append(exactly(INSTALLS, name, "packages", packages))
    return measured


PARTS: dict[str, Callable[[], list[Measurement]]] = {
    STEPPING: stepping,
    TRAINING: training,
    SIMULATING: simulating,
    INSTALLS: installs,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare", description=__doc__.split("\n")[0])
    parser.add_argument("part", nargs="*", choices=[[], *PARTS], help="what is measured (default: everything)")
    chosen = parser.parse_args().part or list(PARTS)
    th.set_num_threads(1)
    for part in chosen:
        measured = PARTS[part]()
        print("\n".join(report(part, measured)), flush=True)
        rows = {(row["table"], row["name"]): row for row in kept_rows(TABLE, COLUMNS)}
        for m in measured:
            rows.pop((m.table, m.name), None)  # it comes again, in the order of the others
            values = (m.table, m.name, m.unit, *(f"{value:.6g}" for value in (m.median, m.lowest, m.highest)))
            rows[m.table, m.name] = dict(zip(COLUMNS, values, strict=True))
        write_rows(TABLE, COLUMNS, sorted(rows.values(), key=lambda row: list(PARTS).index(row["table"])))
    for package in ("benchmarl", "torchrl", "vmas", "gradysim", "stable_baselines3", "torch"):
        print(package, version(package) if find_spec(package) else "is not installed")


if __name__ == "__main__":
    main()
