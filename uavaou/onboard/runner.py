"""Fly one UAV by the files that `uavaou export --format onnx` wrote. Needs NumPy and onnxruntime, nothing else.

    pilot = Pilot(".", uav=0)
    while not pilot.done:
        move, waypoint_m, selected = pilot.decide(position_m, in_range, others_m)
        ...  # collect from the devices selected, then fly to the waypoint
        pilot.end_slot(collected_by)

policy.json states every column of the rows below with its unit, its scaling and where the UAV has it from.
A file that no export wrote is refused before take-off, by a ValueError of one line.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

STAY, UP, DOWN, RIGHT, LEFT = range(5)
STEPS = np.array([[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]])  # (5, 2) grid steps of the moves

MOST_BYTES = 32_000_000  # of policy.json and of mission.json
MOST, MOST_SLOTS = 10**15, 10**6  # any number of mission.json, and its slots, whose squares are summed
MISSION = {  # name: shape for U UAVs and I devices, least, whole numbers
    "slots": ((), 1, True),
    "area_m": ((2,), 1e-3, False),
    "grid_step_m": ((), 1e-3, False),
    "altitude_m": (("U",), 0, False),
    "cds_m": (("U", 2), 0, False),
    "budget_steps": (("U",), 0, True),
    "devices_m": (("I", 2), -MOST, False),
    "update_period_slots": (("I",), 1, True),
    "longest_update_period_slots": ((), 1, True),
    "coverage_radius_m": (("U", "I"), 0, False),
    "collection_radius_m": (("U", "I"), -1, False),
    "own_devices": (("U", "I"), 0, True),
    "pull_weight": (("U", "I"), 1e-9, False),
    "pull_reach_steps": (("U", "I"), 1e-9, False),
}  # fmt: skip
OPTIONAL = {"free_moves": (("U", "C"), 0, True),  # where some legs are closed: of each cell, bit m for move m
            "uplinks_per_slot": ((), 1, True), "silence_slots": ((), 1, True)}  # fmt: skip
PLAN = ("own_devices", "collection_radius_m", "pull_weight", "pull_reach_steps")  # of each set of survivors, too
CHOICES = {
    "schema": (1,),
    "rows": ("flat", "entities"),
    "observation": ("location", "part", "local", "shared"),
    "collection": ("auto", "select"),
    "action": ("greedy", "sample"),
}
TOKENS = ["own", "allowed_moves", "teammates", "devices", "pulls"]  # the last where devices pull
MOST_STEPS = 500  # of a device that this UAV never collects
COLUMNS = ("position", "uav_id", "to_cds", "allowed_moves", "slots_left", "budget_left", "to_device_x", "to_device_y",
           "update_period", "in_range", "since_own_collection", "other_positions", "age_sum")  # fmt: skip


def read(path: Path) -> dict[str, Any]:
    """Read a JSON object of a regular file."""
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path}: expected a file of at most {MOST_BYTES:,} bytes")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected an object")
    return content


def read_mission(path: Path) -> dict[str, Any]:
    """Read mission.json and check every number that the pilot uses."""
    mission, sizes = read(path), dict[str, int]()
    fields = {name: (mission.get(name), *MISSION[name]) for name in MISSION}
    fields |= {name: (mission[name], *OPTIONAL[name]) for name in OPTIONAL if name in mission}
    plans = mission.setdefault("survivors", {})
    if not isinstance(plans, dict) or not all(isinstance(plan, dict) for plan in plans.values()):
        raise ValueError(f"{path}: survivors: expected a plan for each set of UAVs")
    fields |= {f"survivors {key} {name}": (plans[key].get(name), *MISSION[name]) for key in plans for name in PLAN}
    for name, (value, shape, least, whole) in fields.items():
        try:
            array = np.array(value)
        except (ValueError, OverflowError):  # lists of several lengths, or an integer beyond all floats
            array = np.array(None)
        most = MOST_SLOTS if name == "slots" else MOST
        numbers = array.dtype.kind in ("iu" if whole else "iuf") and array.size > 0
        if numbers and array.ndim == len(shape):
            wanted = (sizes.setdefault(size, n) if isinstance(size, str) else size
                      for size, n in zip(shape, array.shape, strict=True))  # fmt: skip
            if array.shape == tuple(wanted) and ((array >= least) & (array <= most)).all():
                continue
        what = "whole numbers" if whole else "numbers"
        of = " of shape (" + ", ".join(str(sizes.get(str(size), size)) for size in shape) + ")" if shape else ""
        raise ValueError(f"{path}: {name}: expected {what}{of} from {least} to {most:,}")
    return mission


def read_policy(path: Path) -> dict[str, Any]:
    """Read policy.json and check everything that the pilot uses."""
    policy = read(path)
    for name, allowed in CHOICES.items():
        if type(policy.get(name)) is not type(allowed[0]) or policy[name] not in allowed:
            raise ValueError(f"{path}: {name}: expected one of: {', '.join(map(str, allowed))}")
    epsilon = policy.get("epsilon", "missing")
    if epsilon is not None and not (type(epsilon) in (int, float) and 0 <= epsilon <= 1):
        raise ValueError(f"{path}: epsilon: expected null or a number from 0 to 1")
    inputs: Any = policy.get("inputs")
    flat = policy["rows"] == "flat"
    try:
        names = list(inputs["local"]["columns"] if flat else inputs)
        fits = [*inputs] == ["local"] and names and {*names} <= {*COLUMNS} if flat else names in (TOKENS[:4], TOKENS)
    except (KeyError, TypeError):  # no objects of these names
        fits = False
    if not fits:
        raise ValueError(f"{path}: inputs: expected those of rows that are {policy['rows']}")
    return policy


class Pilot:
    """Decides slot by slot for one UAV.

    Args:
        folder: with policy.onnx, policy.json and mission.json.
        uav: number of this UAV in mission.json, from 0.
        action: "greedy" or "sample"; None for the one that policy.json states.
        seed: of the draws of "sample".
    """

    def __init__(self, folder: str | Path, uav: int, action: str | None = None, seed: int = 0) -> None:
        folder = Path(folder)
        self.policy, mission = read_policy(folder / "policy.json"), read_mission(folder / "mission.json")
        if uav not in range(len(mission["cds_m"])):
            raise ValueError(f"uav = {uav}: expected 0 to {len(mission['cds_m']) - 1}")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(folder / "policy.onnx", options, ["CPUExecutionProvider"])
        self.mission, self.uav, self.slot, self.flown = mission, uav, 1, 0
        self.action, self.draws = action or self.policy["action"], np.random.default_rng([seed, uav])
        self.shared, self.alone = (self.policy["observation"] == name for name in ("shared", "part"))
        self.auto = self.policy["collection"] == "auto"
        self.area, self.step = np.array(mission["area_m"]), mission["grid_step_m"]  # (2,) m, m
        self.cds = np.rint(np.array(mission["cds_m"]) / self.step).astype(int)  # (U, 2) cells
        self.altitude = np.array(mission["altitude_m"])  # (U,) m
        self.others = [v for v in range(len(self.cds)) if v != uav]
        self.devices = np.array(mission["devices_m"])  # (I, 2) m
        self.period = np.array(mission["update_period_slots"])  # (I,) slots, k_i
        self.radius = np.array(mission["coverage_radius_m"]) / self.step  # (U, I) grid steps
        self.columns, self.rows = (np.floor(self.area / self.step + 0.5) + 1).astype(int).tolist()
        self.zones = "free_moves" in mission
        if self.zones:
            self.read_zones(np.array(mission["free_moves"])[uav], folder)
        self.pulled = "pulls" in self.policy["inputs"]
        self.plans: dict[str, tuple[Any, Any]] = {}  # by survivors: whether each device is in its part, and steps
        self.linked, self.most = "silence_slots" in mission, mission.get("uplinks_per_slot", len(self.period))
        self.heard, self.known = np.zeros(len(self.cds), dtype=int), self.cds.copy()  # (U,) slots of news, (U, 2) cells
        self.last_own = np.zeros(len(self.period), dtype=int)  # (I,) slot of this UAV's last collection, 0: none yet
        self.last, self.last_in_range = (
            self.last_own.copy(),
            self.last_own.copy(),
        )  # of any UAV; in its range, if served
        self.kept = self.last_own > 0  # (I,) devices in range that it can serve in this slot

    def read_zones(self, bits: Any, folder: Path) -> None:
        """Prepare the ways by free legs, from the free moves (C,) of each cell: column * rows + row."""
        cells = np.stack(np.divmod(np.arange(len(bits)), self.rows), axis=-1)  # (C, 2)
        if len(bits) != self.columns * self.rows or not (bits[cells @ [self.rows, 1]] < 32).all():
            raise ValueError(f"{folder / 'mission.json'}: free_moves: expected a number below 32 for each cell")
        self.free = (bits[:, None] >> np.arange(5)) % 2 == 1  # (C, 5)
        to = cells[:, None] + STEPS  # (C, 5, 2)
        self.free &= ((to >= 0) & (to < [self.columns, self.rows])).all(axis=-1)
        self.to = np.where(self.free, to @ [self.rows, 1], np.arange(len(bits))[:, None])  # (C, 5)
        self.home = self.spread(np.arange(len(bits)) == self.cds[self.uav] @ [self.rows, 1])  # (C,) moves to the CDS

    def spread(self, there: Any) -> Any:
        """The moves by free legs from each cell to the nearest of those marked, (C, ...)."""
        steps = np.where(there, 0.0, np.inf)
        while not np.array_equal(nearer := np.minimum(steps, steps[self.to].min(axis=1) + 1), steps):
            steps = nearer
        return steps

    def number(self, cell: Any) -> Any:
        """The number of a cell, which lies on the grid."""
        return np.clip(cell, 0, [self.columns - 1, self.rows - 1]) @ [self.rows, 1]

    def moves_home(self, cell: Any) -> Any:
        """The moves from a cell, or from cells (..., 2), to the CDS."""
        if self.zones:
            return self.home[self.number(cell)]
        return np.abs(cell - self.cds[self.uav]).sum(axis=-1)

    @property
    def done(self) -> bool:
        """Whether the mission is over."""
        return bool(self.slot > self.mission["slots"])

    def decide(
        self, position_m: Any, in_range: Any, others_m: Any = (), messages: Any = (), rates: Any = None
    ) -> tuple[int, Any, Any]:
        """Return the move of this slot, where it leads, (2,) m, and the devices to collect from, bool (I,).

        Args:
            position_m: of this UAV, (2,) m from the corner of the area.
            in_range: whether a device's rate to this UAV reaches the minimum in this slot, (I,).
            others_m: positions of the other UAVs in the order of their numbers, (U - 1, 2) m, NaN for a lost one; for
                "shared" alone. Where mission.json has silence_slots: none, but their ``messages`` of this slot.
            rates: of the devices, (I,), for uplinks_per_slot alone; of equal ones the lower number comes first.
        """
        cell = np.rint(np.asarray(position_m) / self.step).astype(int)  # (2,)
        in_range, allowed = np.asarray(in_range, dtype=bool), self.allowed_moves(cell)
        rates = np.zeros(len(self.period)) if rates is None else np.asarray(rates)
        cells, present, fresh = self.listen(cell, others_m, messages)
        ages = self.ages(self.slot + 1, self.last if self.linked else self.last_in_range)  # (I,)
        self.kept = self.keep(in_range, ages, rates)
        if self.policy["rows"] == "flat":
            values = self.flat_row(cell, allowed, in_range, cells[self.others] * self.step)
            inputs = [np.concatenate([np.ravel(values[name]) for name in self.policy["inputs"]["local"]["columns"]])]
        else:
            self.mine, self.steps = self.plan(present)
            inputs = self.tokens(cell, allowed, in_range, cells, present, fresh)
        rows = {
            name: np.asarray(row, dtype=np.float32)[None]
            for name, row in zip(self.policy["inputs"], inputs, strict=True)
        }
        logits = [row[0] for row in self.session.run(None, rows)]
        move, selected = self.choose(logits[0], logits[1] if len(logits) > 1 else None, allowed, in_range)
        selected = self.kept = self.kept if self.auto else self.keep(selected, rates, rates)
        move = move if self.on_grid(cell)[move] else STAY
        move = move if allowed[move] else self.step_home(cell)
        self.flown += int(move != STAY)
        return move, (cell + STEPS[move]) * self.step, selected

    def end_slot(self, collected_by: Any) -> None:
        """End the slot.

        Args:
            collected_by: the number of the UAV that collected each device in it, (I,), -1 for none. A policy with
                "local" observation needs this UAV's own number alone.
        """
        own, by_any = np.asarray(collected_by) == self.uav, np.asarray(collected_by) >= 0  # (I,)
        known = by_any if not self.linked else self.kept if self.auto else own
        self.last[known] = self.last_in_range[self.kept] = self.last_own[own] = self.slot
        self.slot += 1

    def keep(self, offered: Any, first: Any, second: Any) -> Any:
        """As many of the devices offered, (I,), as it can serve: the largest by ``first``, and then by ``second``."""
        if offered.sum() <= self.most:
            return offered
        order = np.lexsort((-second, -first, ~offered))
        return np.isin(np.arange(len(offered)), order[: self.most])

    def message(self, position_m: Any) -> dict[str, Any]:
        """What it tells the others in this slot, before it decides: all that it knows."""
        self.heard[self.uav], self.known[self.uav] = self.slot, np.rint(np.asarray(position_m) / self.step)
        return {"heard": self.heard.tolist(), "cells": self.known.tolist(), "collected": self.last.tolist()}

    def listen(self, cell: Any, others_m: Any, messages: Any) -> tuple[Any, Any, float]:
        """Cells (U, 2) where it knows UAVs to be, how fresh that is, 0 for lost ones, (U,), and the news of devices."""
        if not self.linked:
            cells = self.cds.astype(float)
            if self.shared:
                cells[self.others] = np.rint(np.reshape(others_m, (-1, 2)) / self.step)
            return cells, 1.0 - np.isnan(cells[:, 0]), float(self.shared)
        self.message(cell * self.step)
        for message in messages:
            heard, newer = np.array(message["heard"]), np.array(message["heard"]) > self.heard
            self.heard[newer], self.known[newer] = heard[newer], np.array(message["cells"])[newer]
            self.last = np.maximum(self.last, message["collected"])
        age = (self.slot - self.heard) * self.shared
        present = np.where(age < self.mission["silence_slots"], 20 / (20 + age), 0)
        fresh = [present[v] * (self.heard[v] > 0) for v in self.others if present[v] > 0] or [1.0]
        return self.known if self.shared else self.cds, present, float(np.mean(fresh)) * self.shared

    def plan(self, present: Any) -> tuple[Any, Any]:
        """Whether each device is in its part, (I,), and the steps to it, (X, Y, I), where those present are left."""
        key = " ".join(map(str, np.flatnonzero(present)))
        if key not in self.plans:
            of = self.mission["survivors"].get(key, self.mission)
            own, radius, weight, reach = (np.array(of[name], dtype=float)[self.uav] for name in PLAN)  # (I,) each
            steps = np.minimum(self.steps_left(radius) / reach - np.log(weight), MOST_STEPS) if self.pulled else 0
            self.plans[key] = own == 1, steps
        return self.plans[key]

    def on_grid(self, cell: Any) -> Any:
        """The moves (5,) that stay on the grid."""
        after = cell + STEPS  # (5, 2)
        return ((after >= 0) & (after * self.step <= self.area + self.step / 2)).all(axis=1)

    def allowed_moves(self, cell: Any) -> Any:
        """The moves (5,) on the grid after which this UAV still gets home by the last slot and within its budget."""
        left, stays = self.mission["slots"] - self.slot, np.arange(5) == STAY  # slots, (5,)
        home = self.moves_home(cell + STEPS)  # (5,) grid steps
        in_time = (home <= left - 1) & (home + ~stays <= self.mission["budget_steps"][self.uav] - self.flown)
        free = self.free[self.number(cell)] if self.zones else True  # (5,)
        return self.on_grid(cell) & free & in_time if left else stays

    def step_home(self, cell: Any) -> int:
        """The first step to the CDS, along x first: what takes the place of a move that is not allowed."""
        if self.zones:
            nearer = self.home[self.to[self.number(cell)]] < self.moves_home(cell)  # (5,)
            return next((move for move in (RIGHT, LEFT, UP, DOWN) if nearer[move]), STAY)
        x, y = self.cds[self.uav] - cell
        return (RIGHT if x > 0 else LEFT) if x else (UP if y > 0 else DOWN) if y else STAY

    def choose(self, moves: Any, devices: Any, allowed: Any, in_range: Any) -> tuple[int, Any]:
        """A move and a selection (I,) from the logits (5,) and (I,); without ``devices``, all in range."""
        epsilon, draw = self.policy["epsilon"], self.draws.random
        if self.action == "sample" and epsilon is None:  # softmax and sigmoid
            move = int(np.argmax(moves + self.draws.gumbel(size=5)))
            selected = in_range if devices is None else draw(len(in_range)) * (1 + np.exp(-devices.clip(-80))) < 1
        elif self.action == "sample" and draw() < epsilon:  # uniform
            move = int(self.draws.choice(np.flatnonzero(allowed)))
            selected = in_range if devices is None else draw(len(in_range)) < 0.5
        else:
            move, selected = int(np.argmax(moves)), in_range if devices is None else devices > 0
        return move, selected & in_range

    def ages(self, slot: int, last: Any) -> Any:
        """Age sums (I,) in slots before a ``slot``, of devices collected in the slots ``last`` (I,); eq. (1)."""
        first, newest = last // self.period, (slot - 1) // self.period  # numbers of updates
        waiting = newest * (newest + 1) - first * (first + 1)
        return (newest - first) * slot - self.period * waiting // 2 + np.where(last == 0, slot - 1, 0)

    def steps_left(self, radius: Any) -> Any:
        """Grid steps from each cell (X, Y) to the nearest within the ``radius`` (I,) in m of each device, (X, Y, I)."""
        shape = self.columns, self.rows
        cells = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)  # (X, Y, 2)
        away = np.linalg.norm(cells[:, :, None] * self.step - self.devices, axis=-1)  # (X, Y, I) m
        steps = np.where(away <= radius + 1e-6, 0.0, MOST_STEPS)
        if self.zones:
            good = (steps == 0) & (self.home < np.inf).reshape(*shape, 1)
            return np.minimum(self.spread(good.reshape(len(self.to), -1)), MOST_STEPS).reshape(steps.shape)
        for line in (steps, steps.swapaxes(0, 1)):
            for there in range(1, len(line)):
                np.minimum(line[there], line[there - 1] + 1, out=line[there])
            for there in range(len(line) - 2, -1, -1):
                np.minimum(line[there], line[there + 1] + 1, out=line[there])
        return steps

    def waiting(self, last: Any) -> Any:
        """The scaled slots since the slots ``last``: 0 for none, towards 1."""
        since = np.minimum(self.slot - last, self.mission["slots"])
        return since / (since + 20)

    def flat_row(self, cell: Any, allowed: Any, in_range: Any, others_m: Any) -> dict[str, Any]:
        """The runs of columns of the flat row, by name."""
        slots, at, span = self.mission["slots"], cell * self.step, self.area.max()
        to_device = (self.devices - at) / span  # (I, 2)
        return {
            "position": at / self.area,
            "uav_id": np.arange(len(self.cds)) == self.uav,
            "to_cds": (self.cds[self.uav] - cell) * self.step / span,
            "allowed_moves": allowed,
            "slots_left": (slots + 1 - self.slot) / slots,
            "budget_left": min(self.mission["budget_steps"][self.uav] - self.flown, slots) / slots,
            "to_device_x": to_device[:, 0],
            "to_device_y": to_device[:, 1],
            "update_period": self.period / self.mission["longest_update_period_slots"],
            "in_range": in_range,
            "since_own_collection": self.waiting(self.last_own),
            "other_positions": others_m / self.area,
            "age_sum": np.sqrt(self.ages(self.slot, self.last)) / 20,
        }

    def tokens(self, cell: Any, allowed: Any, in_range: Any, cells: Any, present: Any, fresh: float) -> list[Any]:
        """The tokens of this UAV (8,), its allowed moves (5,), its teammates (U - 1, 7) and the devices (I, 15)."""
        slots, uav, others, ones = self.mission["slots"], self.uav, self.others, np.ones(len(self.period))
        left, home = slots + 1 - self.slot, self.cds - cell  # slots, (U, 2) grid steps
        spare = min(slots - self.slot, self.mission["budget_steps"][uav] - self.flown) - self.moves_home(cell)
        mine, there = self.mine, (present[others] > 0) & (not self.alone)  # (I,), (U - 1,)
        sizes = np.log((max(mine.sum(), 1) if self.alone else len(ones)) / 25), np.log((1 + there.sum()) / 3)
        own = np.array([1, *home[uav] / 5, left / (left + 100), np.clip(spare, 0, 40) / 20, self.altitude[uav] / 100,
                        *sizes])  # fmt: skip
        to_mates = cells[others] - cell if self.shared else np.zeros((len(others), 2))
        mates = np.column_stack([
            present[others], to_mates / 5, np.linalg.norm(to_mates, axis=1) / 5,
            (self.altitude[others] - self.altitude[uav]) / 20, home[others] / 5,
        ])  # fmt: skip
        to_device, radius = self.devices / self.step - cell, self.radius[uav]  # (I, 2), (I,) grid steps
        distance = np.linalg.norm(to_device, axis=1)
        away = np.maximum(distance - radius, 0)  # grid steps until this UAV covers the device
        steps = np.linalg.norm(self.devices / self.step - cells[others, None], axis=2) - self.radius[others]
        other = np.maximum(steps[there], 0).min(axis=0, initial=20)  # (I,) until the nearest other UAV does
        last = self.last if self.shared else self.last_own
        age = np.sqrt(self.ages(self.slot, last)) / 20
        devices = np.column_stack([
            ones, to_device / 5, distance / 5, away / 5, radius / 2, in_range, self.period / 5,
            self.waiting(self.last_own), age, self.waiting(last), other / 5, np.clip(away - other, -10, 10) / 5,
            age / (1 + away), mine,
        ])  # fmt: skip
        mates[~there], devices[~mine & self.alone] = 0, 0
        tokens = [own, allowed, mates, devices]
        if self.pulled:
            open_to = self.free[self.number(cell)] if self.zones else self.on_grid(cell)  # (5,)
            moved = np.where(open_to[:, None], cell + STEPS, cell)  # (5, 2)
            last = self.last_in_range if self.auto and not self.shared else last
            age = np.where(self.kept, 0, self.ages(self.slot + 1, last))
            pulls = np.column_stack([age, self.steps[moved[:, 0], moved[:, 1]].T, ones * fresh])
            pulls[~mine & self.alone] = 0
            tokens.append(pulls)
        return tokens
