"""What happened in a mission beside the paper's, in minutes: how old the data got, failures, swaps, news, capacity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uavaou.arrays import Floats
from uavaou.evaluation.recorded_mission import RecordedMission
from uavaou.scenario import Scenario


def mission_story(name: str, mission: RecordedMission) -> list[str]:
    """The mission of a policy in a few lines; none where the scenario has only what the paper has."""
    lines = [line for line in _lines(mission) if line]
    return [f"The mission of {name}, by its clock:", *lines] if lines else []


def _lines(mission: RecordedMission) -> Iterator[str]:
    scenario, recording = mission.scenario, mission.recording
    items = (recording.failed, recording.battery, recording.heard, recording.wind, recording.rejected_capacity)
    if any(item is not None for item in items) or scenario.age_limit_s is not None or scenario.devices_silent:
        yield _ages(mission)
    yield from _failures(mission)
    if recording.battery is not None:
        yield _swaps(mission, recording.battery)
    if recording.heard is not None and scenario.uavs > 1:
        yield _news(mission)
    if recording.wind is not None:
        speed = np.hypot(*recording.wind.T)  # (K,) m/s
        yield f"wind: {speed.mean():.1f} m/s in the mean, up to {speed.max():.1f} m/s"
    if recording.rejected_capacity is not None:
        yield f"beyond the capacity: {int(recording.rejected_capacity.sum()):,} transfers that were in range"


def _ages(mission: RecordedMission) -> str:
    minutes, ages = mission.scenario.slot_length_s / 60, mission.aoi_slots  # (K, I) slots
    peaks = 1 + np.concatenate([np.zeros_like(ages[:1]), ages[:-1]])  # (K, I) slots, just before a delivery
    slot, device = np.unravel_index(int(peaks.argmax()), peaks.shape)
    text = f"age of information: {minutes * ages.mean():.3g} min in the mean, "
    text += f"at most {minutes * peaks.max():.3g} min "
    text += f"({mission.scenario.device_name(int(device))}, at {clock(mission.scenario, int(slot) + 1)})"
    if mission.late is not None and mission.scenario.age_limit_s is not None:
        text += f"; above {mission.scenario.age_limit_s / 60:.3g} min for {100 * mission.late.mean():.2g} % of the time"
    return text


def _failures(mission: RecordedMission) -> Iterator[str]:
    scenario, positions = mission.scenario, mission.recording.positions
    minutes = scenario.slot_length_s / 60 * mission.aoi_slots.mean(axis=1)  # (K,)
    for slot, u in mission.events["failure"]:
        repairs = [at for at, uav in mission.events["repair"] if uav == u and at > slot]
        end = repairs[0] if repairs else scenario.slots + 1
        x, y = positions[slot - 1, u]
        until = f", repaired at {clock(scenario, end)}" if repairs else ""
        before = f", {minutes[: slot - 1].mean():.3g} min before it" if slot > 1 else ""
        yield (
            f"{_uav(scenario, u)} failed at {clock(scenario, slot)} over ({x:g}, {y:g}) m{until}: data were "
            f"{minutes[slot - 1 : end - 1].mean():.3g} min old in the mean while it was lost{before}"
        )


def _swaps(mission: RecordedMission, battery: Floats) -> str:
    scenario, left = mission.scenario, mission.recording.swap_left
    swaps = np.bincount(mission.events["swap"][:, 1], minlength=scenario.uavs)  # (U,)
    each = ", ".join(f"{_uav(scenario, u)} {count}" for u, count in enumerate(swaps))
    down = 0.0 if left is None else float((left > 0).mean())
    return f"swaps: {each}; {down:.0%} of the time on the ground for them; no battery below {battery.min():.0%}"


def _news(mission: RecordedMission) -> str:
    scenario, heard = mission.scenario, mission.recording.heard
    assert heard is not None
    slot = np.arange(1, scenario.slots + 1)[:, None, None]  # (K, 1, 1)
    old = (slot - heard)[:, ~np.eye(scenario.uavs, dtype=np.bool_)]  # (K, pairs) slots
    alive = np.ones((scenario.slots, scenario.uavs), dtype=np.bool_)
    if mission.recording.failed is not None:
        alive = mission.recording.failed == 0
    both = (alive[:, :, None] & alive[:, None, :])[:, ~np.eye(scenario.uavs, dtype=np.bool_)]  # (K, pairs)
    if not both.any():
        return ""
    seconds = scenario.slot_length_s * old[both].mean()
    return f"messages: {np.mean(old[both] == 0):.0%} passed between UAVs that fly; their news was {seconds:.3g} s old"


def _uav(scenario: Scenario, uav: int) -> str:
    return f"UAV {uav}" if scenario.uav_names is None else scenario.uav_name(uav)


def clock(scenario: Scenario, slot: int) -> str:
    """The time of a slot in the mission: minutes and seconds, or hours and minutes."""
    seconds = round(slot * scenario.slot_length_s)
    large, small, unit = (60, 1, "min") if seconds < 3600 else (3600, 60, "h")
    return f"{seconds // large}:{seconds % large // small:02d} {unit}"
