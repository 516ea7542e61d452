"""A page that replays missions in a browser: one HTML file that needs no server and no network.

``web/`` holds its parts. The missions stand in it as JSON; what has a number for each slot is packed.
"""

import base64
import json
import re
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission, read_mission
from uavaou.field.geodesy import Projection
from uavaou.files import read_text, write_text
from uavaou.reports import style
from uavaou.scenario import Scenario
from uavaou.world.coverage import drawn_radius
from uavaou.world.links import SILENCE_SLOTS

STUDY_REPLAY = "replay.html"
_CONTENT = re.compile(r'<script type="application/json" id="mission">(.*?)</script>', re.DOTALL)
_MOST_BYTES = 100_000_000
_WEB = Path(__file__).parent / "web"
_SCRIPTS = (
    "mission",
    "operations",
    "colours",
    "map",
    "chart",
    "table",
    "player",
)  # each uses what those before it define


def write_replay(path: Path, missions: Mapping[str, RecordedMission]) -> None:
    """Write the page that replays one mission as several policies flew it, side by side.

    Args:
        path: of the page.
        missions: label -> what the policy of that label did. All have one scenario, seed and layout.

    Raises:
        InputError: they are not one mission, or the file cannot be written.
    """
    write_text(path, fill_page(replay_content(missions)))


def by_label(
    missions: Iterable[RecordedMission], algorithms: Mapping[str, str] | None = None
) -> dict[str, RecordedMission]:
    """Missions by what people call the policy that flew them, such as ``MAPPO, seed 0``; equal labels are numbered.

    Args:
        missions: as they shall stand side by side.
        algorithms: variant -> algorithm, of a study.
    """
    flown = list(missions)
    looks = style.looks([mission.policy for mission in flown], algorithms)
    labels: dict[str, RecordedMission] = {}
    for mission in flown:
        seed = "" if mission.training_seed is None else f", seed {mission.training_seed}"
        label = looks[mission.policy].label.replace("\\$", "$") + seed  # matplotlib's escape
        again = sum(other == label or other.startswith(f"{label} (") for other in labels)
        labels[f"{label} ({again + 1})" if again else label] = mission
    return labels


def write_study_replay(study: Path, algorithms: Mapping[str, str]) -> None:
    """Write the page of a study's recorded missions, the lowest mean AoU first; none where it has no missions.

    Args:
        study: ``results/studies/<name>``, which gets ``replay.html``.
        algorithms: variant -> algorithm.

    Raises:
        InputError: a recorded mission cannot be read, or the page not be written.
    """
    missions = [read_mission(path) for path in sorted(study.glob("mission-*.json"))]
    if missions:
        missions.sort(key=lambda mission: mission.mean_aou_slots)
        write_replay(study / STUDY_REPLAY, by_label(missions, algorithms))


def replay_content(missions: Mapping[str, RecordedMission]) -> dict[str, Any]:
    """What the page shows, ready for JSON; ages in whole slots, places in m.

    Raises:
        InputError: the missions differ in scenario, seed or layout.
    """
    check_one_mission(missions)
    first = next(iter(missions.values()))
    scenario, layout = first.scenario, first.recording.layout
    return {
        "scenario": scenario.name,
        "mission_seed": first.mission_seed,
        "slots": scenario.slots,
        "slot_length_s": scenario.slot_length_s,
        "area_m": [scenario.area_x_m, scenario.area_y_m],
        "grid_step_m": scenario.grid_step_m,
        "cds_m": [list(place) for place in scenario.cds_m],
        "altitudes_m": list(scenario.altitudes_m),
        "devices": {
            "x_m": _rounded(layout.positions[:, 0]),
            "y_m": _rounded(layout.positions[:, 1]),
            "update_period_slots": layout.update_period.tolist(),
            "coverage_m": _rounded(drawn_radius(scenario, layout)),
        },
        **_field(scenario),
        **({"operations": operations} if (operations := _operations(scenario)) else {}),
        "policies": [{"name": label} | _packed_mission(mission) for label, mission in missions.items()],
    }


def _field(scenario: Scenario) -> dict[str, Any]:
    """What a map of a real field has: names, outline, zones, and where its corners lie on the earth."""
    field: dict[str, Any] = {
        "device_names": scenario.device_names,
        "uav_names": scenario.uav_names,
        "outline_m": scenario.outline_m,
        "zones": [{"polygon_m": zone.polygon_m, "name": zone.name} for zone in scenario.no_fly or ()],
    }
    if scenario.georeference is not None:
        field["bearing_deg"] = scenario.georeference.bearing_deg
        corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * [scenario.area_x_m, scenario.area_y_m]  # (4, 2) m
        with suppress(InputError):  # pyproj is not installed: the page has metres alone
            field["corners_deg"] = Projection(scenario.georeference).to_degrees(corners).round(9).tolist()
    return {name: value for name, value in field.items() if value not in (None, [], ())}


def _operations(scenario: Scenario) -> dict[str, Any]:
    """Which items of a mission beside the paper's are on, with their limits; empty where none is."""
    items = {
        "batteries": scenario.energy is not None,
        "stations_m": [place for place in scenario.stations_m or () if place not in scenario.cds_m],
        "failures": bool(scenario.failures or scenario.failure_probability_per_slot),
        "silent": bool(scenario.devices_silent),
        "links": scenario.links is not None,
        "wind": scenario.wind is not None,
        "capacity": scenario.uplinks_per_slot,
        "age_limit_s": scenario.age_limit_s,
    }
    shown = {name: value for name, value in items.items() if value}
    return shown | ({"silence_slots": scenario.silence_slots or SILENCE_SLOTS} if "links" in shown else {})


def check_one_mission(missions: Mapping[str, RecordedMission]) -> None:
    """Refuse missions that cannot stand side by side.

    Raises:
        InputError: they differ in scenario, seed or layout.
    """
    (name, first), *others = missions.items()
    for other, mission in others:
        differing = [what for what in ("scenario", "mission_seed") if getattr(first, what) != getattr(mission, what)]
        layouts = vars(first.recording.layout), vars(mission.recording.layout)
        differing += [
            f"{what} of the devices" for what in layouts[0] if not np.array_equal(*(lay[what] for lay in layouts))
        ]
        if differing:
            raise InputError(f"'{name}' and '{other}' did not fly one mission: they differ in {', '.join(differing)}")


def fill_page(content: Mapping[str, Any]) -> str:
    """The page around the ``content`` that :func:`replay_content` gives."""
    title = f"{content['scenario']}: {' and '.join(policy['name'] for policy in content['policies'])}"
    mission = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")  # nothing in it ends the script
    script = "\n".join(_web(f"{name}.js") for name in _SCRIPTS)
    page = Template(_web("page.html"))
    return page.substitute(title=escape(title), style=_web("style.css"), mission=mission, script=script)


def read_content(page: Path) -> dict[str, Any]:
    """What stands in a page, as :func:`replay_content` gave it.

    Raises:
        InputError: the file cannot be read, or is no such page.
    """
    found = _CONTENT.search(read_text(page, _MOST_BYTES))
    if found is None:
        raise InputError(f"'{page}': holds no mission: expected a page that `uavaou replay` wrote")
    content: dict[str, Any] = json.loads(found[1])
    return content


def _packed_mission(mission: RecordedMission) -> dict[str, str]:
    """What a policy did, slot by slot: cells (K, U, 2), the UAV of each communication (K, I) or -1, ages (K, I)."""
    recording = mission.recording
    carried_by = np.where(recording.communications, recording.collected_by, -1)  # (K, I)
    cells = np.rint(recording.positions / mission.scenario.grid_step_m)  # (K, U, 2) column, row
    # Most ages grow by the same number as in the slot before, so that second differences are mostly 0.
    start = np.zeros((2, mission.age_slots.shape[1]), dtype=np.int64)  # (2, I)
    bends = np.diff(np.concatenate([start, mission.age_slots]), n=2, axis=0)  # (K, I)
    packed = {"cells": cells, "carried_by": carried_by, "age_bends": bends} | _packed_operations(mission)
    return {name: _packed(values) for name, values in packed.items()}


def _packed_operations(mission: RecordedMission) -> dict[str, ArrayLike]:
    """What ``web/operations.js`` shows: batteries in thousandths, wind in dm/s, the age of news in slots."""
    scenario, recording = mission.scenario, mission.recording
    silence = scenario.silence_slots or SILENCE_SLOTS
    found: dict[str, Any] = {
        "battery": None if recording.battery is None else np.rint(1000 * recording.battery),  # (K, U)
        "swap_left": recording.swap_left,  # (K, U)
        "failed": recording.failed,  # (K, U)
        "wind": None if recording.wind is None else np.rint(10 * recording.wind),  # (K, 2)
        "beyond": recording.rejected_capacity,  # (K,)
        "late": mission.late,  # (K, I)
        "silent": mission.silent if scenario.devices_silent else None,  # (K, I)
    }
    if recording.heard is not None:
        slot = np.arange(1, scenario.slots + 1)[:, None, None]  # (K, 1, 1)
        found["news"] = np.minimum(slot - recording.heard, silence)  # (K, U, U)
    return {name: values for name, values in found.items() if values is not None}


def _packed(values: ArrayLike) -> str:
    """Whole numbers as 32-bit words, the lowest byte first; zlib, base64."""
    words = np.ascontiguousarray(values).astype("<i4")
    return base64.b64encode(zlib.compress(words.tobytes(), 6)).decode("ascii")


def _rounded(values: Floats) -> list[float]:
    """Lengths in m to a millimetre, which no screen shows."""
    return [round(float(value), 3) for value in values]


def _web(name: str) -> str:
    return (_WEB / name).read_text(encoding="utf-8")
