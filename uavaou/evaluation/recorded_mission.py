"""One mission, slot by slot: played, kept as a small file, read again without the policy that flew it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from uavaou.arrays import Bools, Floats, Ints
from uavaou.errors import InputError
from uavaou.fields import Numbers, Whole, WholeNumbers, reads_schema, validated
from uavaou.files import read_json, write_text
from uavaou.planners.base import Planner
from uavaou.scenario import Layout, Scenario
from uavaou.world import World
from uavaou.world.losses import Losses

SCHEMA = 1
_OPERATIONS = ("failed", "battery", "swap_left", "heard", "wind", "rejected_capacity")
_USUAL = {"battery": 1.0}  # what a mission without the item shows; of the others 0
_DIGITS = 4
_MOST_BYTES = 50_000_000


@dataclass(frozen=True)
class Recording:
    """One mission; row t - 1 is slot t."""

    positions: Floats  # (K, U, 2) m, where the UAVs were in the slot
    collected_by: Ints  # (K, I), the u with alpha_iu = 1; -1 for none
    age_sum: Floats  # (K, I) s, sum_n A_i^n at the slot's end
    layout: Layout
    # What a mission holds beside the paper's; None where nothing of it was to be seen.
    failed: Ints | None = None  # (K, U) 1 for a failed UAV
    battery: Floats | None = None  # (K, U) from 0 to 1, at the beginning of the slot
    swap_left: Ints | None = None  # (K, U) slots that the swap of a UAV that is down still takes, with this one
    heard: Ints | None = None  # (K, U, U) the slot that each UAV's news of each other one is of, 0 for never
    wind: Floats | None = None  # (K, 2) m/s towards +x and +y
    rejected_capacity: Ints | None = None  # (K,) devices in range beyond the capacity

    @classmethod
    def from_snapshots(cls, snapshots: Sequence[dict[str, Any]]) -> Recording:
        """Stack what :meth:`uavaou.world.World.snapshot` gave after each slot, from the first on."""
        first = snapshots[0]
        stacked = {name: np.stack([shot[name] for shot in snapshots]) + 0 for name in _OPERATIONS}
        return cls(
            **{
                name: values.round(_DIGITS) for name, values in stacked.items() if (values != _USUAL.get(name, 0)).any()
            },
            positions=np.stack([shot["positions"] for shot in snapshots]),
            collected_by=np.stack([shot["collected_by"] for shot in snapshots]),
            age_sum=np.stack([shot["age_sum"] for shot in snapshots]),
            layout=Layout(first["devices"], first["bandwidth"], first["transmit_power"], first["update_period"]),
        )

    @cached_property
    def communications(self) -> Bools:
        """Whether a transfer carried at least one update, (K, I)."""
        slot = np.arange(1, len(self.age_sum) + 1)[:, None]  # (K, 1)
        generated = slot % self.layout.update_period == 0  # (K, I)
        at_start = np.ones((1, self.age_sum.shape[1]), dtype=np.bool_)  # every device holds update 0 before slot 1
        # What is pending at a slot's end has aged by a slot or more, so that an age of 0 means nothing pending.
        before = np.concatenate([at_start, self.age_sum[:-1] > 0])  # (K, I)
        carried: Bools = (self.collected_by >= 0) & (before | generated)
        return carried


@dataclass(frozen=True)
class RecordedMission:
    """A mission and who flew it."""

    scenario: Scenario
    policy: str  # a study's variant, or a planner
    training_seed: int | None  # None for a planner
    mission_seed: int
    recording: Recording

    @property
    def mean_aou_slots(self) -> float:
        """Mean over slots of sum_i sum_n A_i^n[t], in slots."""
        return float(self.recording.age_sum.sum(axis=1).mean() / self.scenario.slot_length_s)

    @cached_property
    def age_slots(self) -> Ints:
        """sum_n A_i^n at each slot's end in slots, which are whole, (K, I)."""
        return np.rint(self.recording.age_sum / self.scenario.slot_length_s).astype(np.int64)

    @cached_property
    def silent(self) -> Bools:
        """Which devices are silent, (K, I)."""
        slots, losses = range(1, self.scenario.slots + 1), Losses(self.scenario, 1)
        none = np.zeros(self.scenario.devices, dtype=np.bool_)
        return np.stack([none if (silent := losses.silent(slot)) is None else silent for slot in slots])

    @cached_property
    def aoi_slots(self) -> Ints:
        """The age of information of each device at each slot's end, in slots, (K, I)."""
        slot = np.arange(1, self.scenario.slots + 1)[:, None]  # (K, 1)
        generated = (slot % self.recording.layout.update_period == 0) & ~self.silent  # (K, I)
        newest = np.maximum.accumulate(np.where(generated, slot, 0))  # (K, I)
        delivered = np.maximum.accumulate(np.where(self.recording.collected_by >= 0, newest, 0))  # (K, I)
        return np.asarray(slot - delivered)

    @cached_property
    def late(self) -> Bools | None:
        """Which devices are above the age limit, (K, I); None without one."""
        limit = self.scenario.age_limit_s
        return None if limit is None else np.asarray(self.aoi_slots > limit / self.scenario.slot_length_s * (1 + 1e-9))

    @cached_property
    def events(self) -> dict[str, Ints]:
        """``failure``, ``repair`` and ``swap``, each with its slots and UAVs, (E, 2)."""
        none = np.zeros((self.scenario.slots, self.scenario.uavs), dtype=np.int64)
        failed, swaps = (
            (none if kept is None else kept) > 0 for kept in (self.recording.failed, self.recording.swap_left)
        )
        before_failed, before_swaps = (np.concatenate([none[:1] > 0, now[:-1]]) for now in (failed, swaps))  # (K, U)
        kinds = {"failure": failed & ~before_failed, "repair": before_failed & ~failed, "swap": swaps & ~before_swaps}
        return {kind: np.add(np.argwhere(begins), [1, 0]) for kind, begins in kinds.items()}

    def snapshot(self, slot: int) -> dict[str, Any]:
        """What :meth:`uavaou.world.World.snapshot` gave of a slot, as far as it was kept."""
        kept = {name: values for name, values in vars(self.recording).items() if isinstance(values, np.ndarray)}
        if (late := self.late) is not None:
            kept["late"] = late
        return {"slot": slot} | {name: values[slot - 1] for name, values in kept.items()}


def record_mission(scenario: Scenario, policy: Planner, seed: int) -> Recording:
    """Play one mission, seeded, and keep what every slot looked like."""
    world = World(scenario, missions=1, seed=seed)
    policy.reset(world, seed)
    snapshots = []
    while not world.done:
        world.step(*policy.act(world))
        snapshots.append(world.snapshot())
    return Recording.from_snapshots(snapshots)


def write_mission(path: Path, mission: RecordedMission) -> None:
    """Write a mission as JSON, a line for each slot and table: ages in whole slots, positions in m.

    Raises:
        InputError: the file cannot be written.
    """
    recording, layout = mission.recording, mission.recording.layout
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "policy": mission.policy,
        "training_seed": mission.training_seed,
        "mission_seed": mission.mission_seed,
        "scenario": mission.scenario.to_dict(),
        "layout": {
            "devices_m": layout.positions.tolist(),
            "bandwidth_hz": layout.bandwidth.tolist(),
            "transmit_power_w": layout.transmit_power.tolist(),
            "update_period_slots": layout.update_period.tolist(),
        },
        "positions_m": recording.positions.tolist(),
        "collected_by": recording.collected_by.tolist(),
        "age_sum_slots": mission.age_slots.tolist(),
    }
    content |= {name: values.tolist() for name in _OPERATIONS if (values := getattr(recording, name)) is not None}
    parts = [f"{json.dumps(name)}: {_lines(part)}" for name, part in content.items()]
    write_text(path, "{\n" + ",\n".join(parts) + "\n}\n")


def _lines(part: Any) -> str:
    """Compact JSON; a list of lists with a line for each of its rows, so that versions can be compared."""
    if isinstance(part, list):
        return "[\n" + ",\n".join(json.dumps(row, separators=(",", ":")) for row in part) + "\n]"
    return json.dumps(part)


_Reals = Annotated[Numbers, AfterValidator(lambda array: array.astype(np.float64))]


class _LayoutContent(BaseModel):
    model_config = ConfigDict(arbitrary_types_allowed=True)

    devices_m: _Reals  # (I, 2)
    bandwidth_hz: _Reals  # (I,)
    transmit_power_w: _Reals  # (I,)
    update_period_slots: WholeNumbers  # (I,)


class _Content(BaseModel):
    """The content of a recorded mission's file."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    schema_: Annotated[int, BeforeValidator(reads_schema(SCHEMA))] = Field(alias="schema")
    policy: str
    training_seed: Whole | None = None
    mission_seed: Whole
    scenario: dict[str, Any]
    layout: _LayoutContent
    positions_m: _Reals  # (K, U, 2)
    collected_by: WholeNumbers  # (K, I)
    age_sum_slots: _Reals  # (K, I)
    failed: WholeNumbers | None = None  # (K, U)
    battery: _Reals | None = None  # (K, U)
    swap_left: WholeNumbers | None = None  # (K, U)
    heard: WholeNumbers | None = None  # (K, U, U)
    wind: _Reals | None = None  # (K, 2)
    rejected_capacity: WholeNumbers | None = None  # (K,)


def read_mission(path: Path) -> RecordedMission:
    """Read what :func:`write_mission` wrote.

    Raises:
        InputError: the file cannot be read, or a field is missing or of another shape.
    """
    content = validated(_Content, read_json(path, _MOST_BYTES), str(path))
    scenario, layout = Scenario.from_dict(content.scenario, source=f"{path}: scenario"), content.layout
    slots, uavs, devices = scenario.slots, scenario.uavs, scenario.devices
    shapes: dict[str, tuple[int, ...]] = {
        "positions_m": (slots, uavs, 2),
        "collected_by": (slots, devices),
        "age_sum_slots": (slots, devices),
        "devices_m": (devices, 2),
        "bandwidth_hz": (devices,),
        "transmit_power_w": (devices,),
        "update_period_slots": (devices,),
        **dict.fromkeys(("failed", "battery", "swap_left"), (slots, uavs)),
        "heard": (slots, uavs, uavs),
        "wind": (slots, 2),
        "rejected_capacity": (slots,),
    }
    arrays = vars(content) | vars(layout)
    for field, shape in shapes.items():
        if arrays[field] is not None and arrays[field].shape != shape:
            raise InputError(f"{path}: {field}: expected an array of shape {shape}, not {arrays[field].shape}")
    if not -1 <= content.collected_by.min() <= content.collected_by.max() < uavs:
        raise InputError(f"{path}: collected_by: names UAVs outside 0 to {uavs - 1}")
    if layout.update_period_slots.min() < 1:
        raise InputError(f"{path}: update_period_slots: has a period below 1")
    ages = content.age_sum_slots * scenario.slot_length_s  # (K, I) s
    periods = layout.update_period_slots.astype(np.int64)  # (I,)
    flown = Layout(layout.devices_m, layout.bandwidth_hz, layout.transmit_power_w, periods)
    operations = {name: arrays[name] for name in _OPERATIONS}
    recording = Recording(content.positions_m, content.collected_by, ages, flown, **operations)
    return RecordedMission(scenario, content.policy, content.training_seed, content.mission_seed, recording)
