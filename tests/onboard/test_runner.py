"""The runner makes of what a UAV measures the rows that uavaou makes, and flies as `uavaou eval` does."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.fuzz.targets import seeds
from tests.onboard.policies import QUICK, lively
from uavaou import InputError, World
from uavaou.onboard.export import FILES, write_policy
from uavaou.onboard.graph import inputs_of
from uavaou.onboard.runner import Pilot, read_mission, read_policy
from uavaou.runs.policy import TrainedPolicy
from uavaou.world.channel import rate
from uavaou.world.links import Knowledge
from uavaou.world.pull import PullPlan

SCENARIO = QUICK.replace(slots=60, flight_time_budget_s=140.0)  # shorter than the slots: the budget binds


class Listening:
    """A session that keeps what it is given."""

    def __init__(self, session: Any) -> None:
        self.session = session

    def run(self, names: None, rows: dict[str, Any]) -> Any:
        self.rows = rows
        return self.session.run(names, rows)


def arrived(world: World) -> Any:
    """Which messages have passed in this slot, (to, from): drawn anew by a copy of the links."""
    links = Knowledge(world.scenario, 1, world.flight.cds)
    links.start(world.channel.keys)
    passes = (
        links._passing(world.slot, world.cells)[0]
        & ~np.eye(world.scenario.uavs, dtype=bool)
        & (not links.passes_nothing)
    )
    return passes & ~world.failed[0] & ~world.failed[0, :, None]


def fly(trained: TrainedPolicy, pilots: list[Pilot]) -> list[list[int]]:
    """Play a mission by the pilots, each of which is told what its UAV measures; the moves made in each slot."""
    world = World(trained.views.scenario, 1, seed=3)
    trained.reset(world, 3)
    for pilot in pilots:
        pilot.session = Listening(pilot.session)
    made = []
    while not world.done:
        at, local = world.positions[0], trained.local_rows(world)
        at = np.where(world.failed[0, :, None] & (trained.views.layout.rows == "entities"), np.nan, at)
        others = [np.delete(at, pilot.uav, axis=0) if pilot.shared else () for pilot in pilots]
        sent = [pilot.message(world.positions[0, pilot.uav]) for pilot in pilots] if pilots[0].linked else []
        decided = [
            pilot.decide(
                world.positions[0, pilot.uav], world.in_range[0, pilot.uav], others[pilot.uav],
                [sent[v] for v in np.flatnonzero(arrived(world)[pilot.uav])] if sent else (),
                rate(world.channel.bandwidth[0], world.snr[0, pilot.uav]),
            )
            for pilot in pilots
        ]  # fmt: skip
        for name, rows in inputs_of(local, trained.views.layout, trained.model.policy.pull).items():
            for pilot, expected in zip(pilots, rows, strict=True):
                if world.failed[0, pilot.uav]:
                    continue
                given = pilot.session.rows[name][0]
                if len(expected) < len(given):  # of its part alone: the pilot has tokens of the others, all zero
                    there = pilot.session.rows["devices"][0, :, 0] > 0.5
                    assert not given[~there].any()
                    assert not expected[there.sum() :].any()
                    given, expected = given[there], expected[: there.sum()]
                np.testing.assert_allclose(given, expected, atol=1e-6, rtol=1e-6)
        moves, selections = trained.act(world)
        flying = ~world.failed[0]
        wanted = world.flight.resolve(moves, world.cells, world.allowed_moves, world._on_grid)[0]
        if pilots[0].action == "greedy":
            assert np.array([move for move, _, _ in decided])[flying].tolist() == wanted[flying].tolist()
            chosen = world.collecting if selections is None else selections & world.in_range
            if selections is not None and world.scenario.uplinks_per_slot:
                chosen = world.operations.kept(chosen, world._snr_in_range)
            np.testing.assert_array_equal(np.array([selected for _, _, selected in decided])[flying], chosen[0, flying])
        moves = np.array([[move for move, _, _ in decided]])
        auto = pilots[0].auto and (world.scenario.links or world.scenario.uplinks_per_slot)
        world.step(moves, None if auto else np.array([[selected for _, _, selected in decided]]))
        made.append(moves[0].tolist())
        for pilot in pilots:
            collected_by = world.stepped.association.collected_by[0]
            own = np.where(collected_by == pilot.uav, collected_by, -1)
            pilot.end_slot(collected_by if pilot.shared else own)
        if not world.done:
            at = np.array([waypoint for _, waypoint, _ in decided])
            np.testing.assert_allclose(at[flying], world.positions[0, flying])
    assert all(pilot.done for pilot in pilots)
    return made


def pilots_of(trained: TrainedPolicy, folder: Path, **options: Any) -> list[Pilot]:
    exported = write_policy(trained, "mine", folder)
    assert [path.name for path in exported.files] == list(FILES)
    assert exported.same == exported.rows > 400
    return [Pilot(folder, uav, **options) for uav in range(trained.views.scenario.uavs)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"network": "mlp", "observation": "local", "collection": "auto", "views": 1},
        {"network": "mlp", "observation": "shared", "collection": "select"},
        {"network": "set", "observation": "part", "collection": "auto"},
        {"network": "set", "observation": "local", "collection": "select", "views": 1},
        {"network": "set", "observation": "shared", "collection": "auto"},
        {"observation": "location", "collection": "auto"},  # without masks in the row
        {"masks": False},
        {"algorithm": "vdn", "network": "set", "observation": "shared"},
        {"network": "set", "pull": 12.0, "observation": "local"},
        {"network": "set", "pull": 12.0, "observation": "shared", "collection": "auto"},
        {"network": "set", "pull": 12.0, "observation": "part"},
    ],
)
def test_it_flies_as_the_policy(settings: dict[str, Any], tmp_path: Path) -> None:
    trained = lively(scenario=SCENARIO, **settings)
    made = fly(trained, pilots_of(trained, tmp_path))
    assert len({move for moves in made for move in moves}) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("network", [{"network": "mlp"}, {"network": "set", "pull": 12.0, "collection": "auto"}])
def test_it_flies_around_zones(network: dict[str, Any], tmp_path: Path) -> None:
    zone = {"polygon_m": [(150, -20), (250, -20), (250, 320), (150, 320)]}
    trained = lively(scenario=SCENARIO.replace(no_fly=[zone]), observation="local", views=1, **network)
    pilots = pilots_of(trained, tmp_path)
    made = fly(trained, pilots)
    assert len({move for moves in made for move in moves}) >= 3
    mission = json.loads((tmp_path / "mission.json").read_text())
    mission["free_moves"][0][0] = 32
    (tmp_path / "mission.json").write_text(json.dumps(mission))
    with pytest.raises(ValueError, match="free_moves: expected a number below 32 for each cell"):
        Pilot(tmp_path, 0)


@pytest.mark.slow
@pytest.mark.parametrize("observation", ["local", "shared", "part"])
@pytest.mark.parametrize("collection", ["auto", "select"])
@pytest.mark.parametrize(
    "changes",
    [
        {"uplinks_per_slot": 1, "failures": [{"uav": 1, "slot": 20}]},
        {"uplinks_per_slot": 2, "links": {"probability": 0.3}, "silence_slots": 4},
        {"links": {"probability": 0.3}, "silence_slots": 4, "failures": [{"uav": 0, "slot": 20}]},
        {"links": "none", "age_limit_s": 60, "objective": "above-limit"},
    ],
)
def test_it_flies_missions_as_they_go(
    changes: dict[str, Any], collection: str, observation: str, tmp_path: Path
) -> None:
    scenario = SCENARIO.replace(**changes)
    for network in ({"network": "set", "pull": 12.0}, {"network": "mlp"}):
        if observation == "shared" or network["network"] == "set":
            trained = lively(scenario=scenario, views=1, observation=observation, collection=collection, **network)
            fly(trained, pilots_of(trained, tmp_path))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"energy": {"endurance_s": 300}}, "energy: the runner does not reckon with batteries"),
        ({"wind": {"east_m_s": 3}}, "wind: the runner does not reckon with wind"),
        ({"devices_silent": [{"device": 0, "from": 5}]}, "devices_silent: no UAV on board knows the true ages"),
        ({"links": "perfect", "uavs": 5}, "uavs: plans for all survivors are written for 4 UAVs at most"),
    ],
)
def test_what_a_runner_cannot_know_is_refused(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    trained = lively(scenario=SCENARIO.replace(**changes), network="set", observation="shared")
    with pytest.raises(InputError, match=said):
        write_policy(trained, "mine", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_it_is_drawn_to_devices_by_the_policy_s_plan(tmp_path: Path) -> None:
    layout, rng = SCENARIO.draw_layout(), np.random.default_rng(0)
    pairs, cds = (SCENARIO.uavs, SCENARIO.devices), SCENARIO.cds_cells
    weight, reach = rng.uniform(0.3, 3.0, pairs) * (rng.random(pairs) < 0.7), rng.uniform(0.5, 2.0, pairs)
    plan = PullPlan(weight, reach, rng.choice([0.1, 0.5, 0.9], pairs), cds, layout.positions)
    trained = lively(scenario=SCENARIO, views=1, plan=plan, network="set", pull=12.0, collection="auto")
    fly(trained, pilots_of(trained, tmp_path))


@pytest.mark.slow
def test_it_flies_by_another_radio(tmp_path: Path) -> None:
    city = SCENARIO.replace(radio="ble", line_of_sight="urban")
    trained = lively(scenario=city, network="set", pull=12.0)
    fly(trained, pilots_of(trained, tmp_path))
    told = json.loads((tmp_path / "mission.json").read_text())
    assert told["sensitivity_dbm"] == -95
    assert "rate_min_bit_s" not in told


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo-paper", "vdn"])
def test_it_samples_as_the_policy(algorithm: str, tmp_path: Path) -> None:
    trained = lively(algorithm, SCENARIO, "sample")
    policy: Any = trained.model.policy
    if algorithm == "vdn":
        policy.epsilon.fill_(0.5)
    (pilot, _) = pilots_of(trained, tmp_path)
    assert pilot.action == "sample"
    world = World(SCENARIO, 1500, seed=1)  # all in the first slot, where the fading alone differs
    world.in_range[:] = world.in_range[0]
    world.slot = 2
    trained.reset(world, 0)
    moves, selections = trained.act(world)
    pilot.slot, drawn = 2, []
    for _ in range(1500):
        pilot.flown = 0
        drawn.append(pilot.decide(world.positions[0, 0], world.in_range[0, 0]))
    expected = np.bincount(moves[:, 0], minlength=5) / 1500
    assert (expected > 0.05).sum() > 1
    np.testing.assert_allclose(np.bincount([move for move, _, _ in drawn], minlength=5) / 1500, expected, atol=0.06)
    chosen = selections[:, 0] & world.in_range[:, 0]
    np.testing.assert_allclose(np.mean([each for _, _, each in drawn], axis=0), chosen.mean(axis=0), atol=0.06)


@pytest.mark.slow
def test_it_needs_neither_torch_nor_uavaou(tmp_path: Path) -> None:
    write_policy(lively(network="set"), "mine", tmp_path)
    code = (
        "import sys, runner\n"
        "pilot = runner.Pilot('.', 1)\n"
        "print(pilot.decide([400, 400], [False] * 8)[0])\n"
        "pilot.end_slot([-1] * 8)\n"
        "print([name for name in ('torch', 'uavaou', 'onnx', 'scipy') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    move, absent = run.stdout.splitlines()
    assert (int(move) in range(5), absent) == (True, "[]")


@pytest.mark.parametrize(
    ("rows", "observation"),
    [("flat", "local"), ("flat", "shared"), ("entities", "part"), ("entities", "local"), ("entities", "shared")],
)
def test_the_json_describes_every_column(rows: str, observation: str) -> None:
    from uavaou.onboard.columns import describe_inputs
    from uavaou.world.entities import make_views

    layout = make_views(QUICK, observation, "auto", rows).layout
    described = describe_inputs(layout, observation, pulled=True)
    assert json.loads(json.dumps(described)) == described
    inputs, sources = described["inputs"], described["from"]
    assert list(inputs) == (["local"] if rows == "flat" else [columns.name for columns in layout.local])
    for each in inputs.values():
        assert sum(column["size"] for column in each["columns"].values()) == each["shape"][-1]
        assert {column["from"] for column in each["columns"].values()} <= set(sources)
    by_radio = [column for each in inputs.values() for column in each["columns"].values() if column["from"] == "radio"]
    assert bool(by_radio) == (observation == "shared")


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("mission", {"slots": 0}, "slots: expected whole numbers from 1 to 1,000,000"),
        ("mission", {"own_devices": [0, 1]}, "own_devices: expected whole numbers of shape (2, 8) from 0 to "),
        ("mission", {"grid_step_m": float("nan")}, "grid_step_m: expected numbers from 0.001 to "),
        ("mission", {"cds_m": [[0, 0], [1]]}, "cds_m: expected numbers of shape (2, 2) from 0 to "),
        ("policy", {"action": "best"}, "action: expected one of: greedy, sample"),
        ("policy", {"schema": True}, "schema: expected one of: 1"),
        ("policy", {"epsilon": 2}, "epsilon: expected null or a number from 0 to 1"),
        ("policy", {"rows": "entities"}, "inputs: expected those of rows that are entities"),
    ],
)
def test_what_no_export_wrote_is_refused_in_one_line(
    file: str, change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    content = json.loads(seeds()[f"onboard/{file}.json"]) | change
    (path := tmp_path / f"{file}.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=re.escape(f"{path}: {said}")) as caught:
        {"mission": read_mission, "policy": read_policy}[file](path)
    assert "\n" not in str(caught.value)
