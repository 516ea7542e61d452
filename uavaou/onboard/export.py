"""Take a policy along: a folder with its graph, what its numbers mean, the map, and a runner.

The folder holds ``policy.onnx`` (:mod:`uavaou.onboard.graph`), ``policy.json`` (inputs, outputs, rule of the action),
``mission.json`` (what is told before take-off) and ``runner.py`` (:mod:`uavaou.onboard.runner`, as it is).
"""

import json
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch as th

from uavaou import __version__
from uavaou.arrays import Bools, Floats, Ints, Singles
from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.files import replacing, write_text, writing
from uavaou.onboard import runner
from uavaou.onboard.columns import describe_inputs
from uavaou.onboard.graph import inputs_of, make_graph, optional
from uavaou.radio import THRESHOLDS
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import TrainedPolicy, load_run
from uavaou.scenario import Scenario
from uavaou.world import World
from uavaou.world.flight import free_moves, grid_cells
from uavaou.world.links import SILENCE_SLOTS
from uavaou.world.pull import Plans, steps_left
from uavaou.world.told import rule_plan
from uavaou.world.views import RowViews

SCHEMA = 1
FILES = ("policy.onnx", "policy.json", "mission.json", "runner.py")
_MISSIONS, _SLOTS = 8, 60  # of the comparison with torch: the first slots of as many missions
_MOVE_BITS = 2 ** np.arange(5)  # a cell's free moves as one number
_MOST_SURVIVORS = 4  # UAVs whose sets all have a plan
_LEAST_SAME = 0.99  # of its rows; where two logits are equal but for rounding, either may win


@dataclass(frozen=True)
class Exported:
    """What :func:`export_onnx` has written, and how it compares with the policy in torch."""

    files: list[Path]
    rows: int  # compared
    same: int  # of them with the same action


def export_onnx(run: RunFolder | Path | str, folder: Path, scenario: Scenario | Path | str | None = None) -> Exported:
    """Write the best policy of a run for a computer on board.

    Args:
        run: the run's folder, or the name of a released policy.
        folder: to write to; files of these names are replaced, others stay.
        scenario: the map of ``mission.json``, which the policy must fit; None for the one trained on.

    Raises:
        InputError: the run cannot be loaded, does not fit the scenario, or :func:`write_policy` refuses it.
    """
    run = RunFolder.at(run)
    name = str(run) if run.is_released else "/".join(run.path.parts[-3:])
    return write_policy(load_run(run, scenario), name, folder)


def write_policy(trained: TrainedPolicy, name: str, folder: Path) -> Exported:
    """Write the four files of a policy called ``name``, for the scenario that its views are of.

    Raises:
        InputError: ONNX is not installed, the policy has networks of its own, the scenario draws its devices anew for
            each mission or holds what no runner can know, or the files cannot be written.
    """
    flown, policy = trained.views.scenario, trained.model.policy
    if flown.layout == "resample":
        raise InputError(
            f"scenario '{flown.name}' draws its devices anew for each mission (layout: resample): name the map to fly "
            "with --scenario"
        )
    _check_known(trained.views)
    graph = make_graph(policy)
    rows, same = compare(graph, trained)
    if same < _LEAST_SAME * rows:
        raise InputError(f"'{name}': its policy acts otherwise than its networks ({same:,} of {rows:,} rows agree)")
    texts = {
        "policy.json": _to_json(_describe(name, trained)),
        "mission.json": _to_json(describe_mission(flown, getattr(trained.views, "plan", None), _learns(trained.views))),
        "runner.py": Path(runner.__file__).read_text(encoding="utf-8"),
    }
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(folder / FILES[0], "wb") as file:
            file.write(graph)
    for file_name, text in texts.items():
        write_text(folder / file_name, text)
    return Exported([folder / file_name for file_name in FILES], rows, same)


def start_graph(graph: bytes) -> Any:
    """An onnxruntime session of a graph, on one core."""
    onnxruntime = optional("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(graph, options, ["CPUExecutionProvider"])


def actions_of(outputs: list[Singles]) -> Ints:
    """The likeliest actions (B, 1 + I), or (B, 1), of a graph's outputs."""
    move = outputs[0].argmax(axis=1)[:, None]
    return np.concatenate([move, *(logits > 0 for logits in outputs[1:])], axis=1)


def compare(graph: bytes, trained: TrainedPolicy) -> tuple[int, int]:
    """How many rows of a few missions were compared, and in how many the graph and the policy act alike."""
    policy: Any = trained.model.policy
    session, views = start_graph(graph), trained.views
    world = World(views.scenario, _MISSIONS, EVALUATION_SEED)
    trained.reset(world, EVALUATION_SEED)
    rows = same = 0
    while not world.done and world.slot <= _SLOTS:
        local = trained.local_rows(world)
        wanted = policy.act(th.from_numpy(local), None).numpy().reshape(len(local), -1)
        got = actions_of(session.run(None, inputs_of(local, views.layout, getattr(policy, "pull", False))))
        rows, same = rows + len(local), same + int((got == wanted).all(axis=1).sum())
        world.step(*trained.actions(wanted if views.layout.selects else wanted[:, 0], world))
    return rows, same


def _learns(views: RowViews) -> bool:
    """Whether UAVs learn of losses, and then go by plans for the survivors."""
    scenario = views.scenario
    may_lose = scenario.failures or scenario.failure_probability_per_slot or scenario.links
    return bool(may_lose) and _told(views) and views.layout.rows == "entities"


def _told(views: RowViews) -> bool:
    """Whether others tell a UAV anything: without any link, what it sees as tokens is ``local``."""
    links = views.scenario.links
    silent = links is not None and links.probability == 0.0 and views.layout.rows == "entities"
    return views.observation == "shared" and not silent


def _check_known(views: RowViews) -> None:
    """Refuse missions whose rows the runner cannot write.

    Raises:
        InputError: it names the field and says why.
    """
    scenario = views.scenario
    unknown = {
        "energy": "the runner does not reckon with batteries" if scenario.energy else "",
        "wind": "the runner does not reckon with wind" if scenario.wind else "",
        "devices_silent": "no UAV on board knows the true ages, which observation 'shared' without links has"
        if scenario.devices_silent and views.observation == "shared" and scenario.links is None
        else "",
        "uavs": f"plans for all survivors are written for {_MOST_SURVIVORS} UAVs at most, where UAVs learn of losses"
        if _learns(views) and scenario.uavs > _MOST_SURVIVORS
        else "",
    }
    for field, why in unknown.items():
        if why:
            raise InputError(f"scenario '{scenario.name}': {field}: {why}")


def describe_mission(scenario: Scenario, plan: Plans | None = None, learns: bool = False) -> dict[str, Any]:
    """What the UAVs are told before take-off: the map, the fleet, and what the mean channel and the ``plan`` say.

    Where UAVs learn of losses, there is a plan for each set of survivors.
    """
    world = World(scenario)
    whole = np.ones(scenario.uavs, dtype=np.bool_)
    sets = [np.array(alive) for alive in product((True, False), repeat=scenario.uavs)][1:-1] if learns else []
    optional_fields = {name: getattr(scenario, name) for name in ("uplinks_per_slot",) if getattr(scenario, name)}
    if scenario.links is not None:
        optional_fields["silence_slots"] = scenario.silence_slots or SILENCE_SLOTS
    if sets:
        plans = {" ".join(map(str, np.flatnonzero(alive))): _plan_of(world, plan, alive) for alive in sets}
        optional_fields["survivors"] = plans
    return {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "slots": scenario.slots,
        "slot_length_s": scenario.slot_length_s,
        "area_m": [scenario.area_x_m, scenario.area_y_m],
        "grid_step_m": scenario.grid_step_m,
        "speed_m_s": scenario.speed_m_s,
        **{form: least for form in THRESHOLDS if (least := getattr(scenario, form)) is not None},
        "altitude_m": list(scenario.altitudes_m),
        "cds_m": (scenario.cds_cells * scenario.grid_step_m).tolist(),
        "budget_steps": world.flight.budget.tolist(),
        "devices_m": world.device_positions[0].tolist(),
        "update_period_slots": world.update_period[0].tolist(),
        "longest_update_period_slots": scenario.longest_update_period,
        "coverage_radius_m": (
            world.channel.coverage_radius()[0] / scenario.grid_step_m * scenario.grid_step_m
        ).tolist(),
        **_plan_of(world, plan, whole),
        **optional_fields,
        **({} if (free := free_moves(scenario)) is None else {"free_moves": (free @ _MOVE_BITS).tolist()}),
    }


def _plan_of(world: World, plan: Plans | None, alive: Bools) -> dict[str, Any]:
    """The numbers by which survivors (U,) go."""
    found = rule_plan(world, 0, alive)
    if alive.all() and plan is not None:
        found = (plan.for_maps(world) or [found])[0]
    elif plan is not None:
        found = plan.for_survivors(world, 0, alive) or found
    weight, reach, share = found.numbers
    return {
        "collection_radius_m": _collection_radius(world, share).tolist(),
        "own_devices": found.serves.astype(int).tolist(),
        "pull_weight": weight.tolist(),
        "pull_reach_steps": reach.tolist(),
    }


def _collection_radius(world: World, share: Floats) -> Floats:
    """Distance in m of the farthest cell from which each UAV collects each device well, (U, I); -1 without one.

    Well is with a ``share`` (U, I) of the UAV's best probability.
    """
    cells = grid_cells(world.scenario) * world.scenario.grid_step_m  # (C, 2) m
    away = np.linalg.norm(cells[:, None] - world.device_positions[0], axis=-1)  # (C, I)
    radius: Floats = np.where(steps_left(world, share)[0] == 0.0, away, -1.0).max(axis=1)
    return radius


def _describe(name: str, trained: TrainedPolicy) -> dict[str, Any]:
    """The content of ``policy.json``."""
    views, layout, policy = trained.views, trained.views.layout, trained.model.policy
    epsilon = getattr(policy, "epsilon", None)
    devices = ["rows", "devices" if layout.rows == "entities" else layout.devices]
    meaning = "logit" if epsilon is None else "value"
    outputs = {
        "move_logits": {
            "shape": ["rows", 5], "columns": ["stay", "up (+y)", "down (-y)", "right (+x)", "left (-x)"],
            "meaning": f"{meaning} of the move; -1e9 where it is not allowed; the largest is the likeliest",
        }
    }  # fmt: skip
    if layout.selects:
        of_device = f"{meaning} of collecting from the device" + ("" if epsilon is None else ", less that of not")
        outputs["device_logits"] = {
            "shape": devices, "meaning": f"{of_device}; -1e9 where it is out of range; above 0 selects it",
        }  # fmt: skip
    return {
        "schema": SCHEMA,
        "policy": name,
        "weights_sha256": trained.digest,
        "uavaou": __version__,
        "rows": layout.rows,
        "observation": "local" if views.observation == "shared" and not _told(views) else views.observation,
        "collection": views.collection,
        "action": trained.action,
        "epsilon": None if epsilon is None else float(epsilon),
        **describe_inputs(
            layout,
            "shared" if _told(views) else views.observation.replace("shared", "local"),
            getattr(policy, "pull", False),
        ),
        "outputs": outputs,
    }


def _to_json(content: dict[str, Any], indent: str = "") -> str:
    """JSON with a line for each entry of ``content`` and of the mappings in it that hold others."""
    lines = []
    for name, value in content.items():
        expands = isinstance(value, dict) and any(isinstance(part, dict) for part in value.values())
        text = _to_json(value, indent + " ") if expands else json.dumps(value)
        lines.append(f"{indent} {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(lines) + f"\n{indent}}}" + ("" if indent else "\n")
