"""The exported policy that flies a UAV: a folder of ``uavaou export``, or a run exported for the scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from uavaou.errors import InputError
from uavaou.onboard.export import FILES, describe_mission, write_policy
from uavaou.onboard.graph import optional
from uavaou.runs.policy import load_run
from uavaou.scenario import Scenario

if TYPE_CHECKING:
    from uavaou.onboard.runner import Pilot

_MAP = (  # what must be the same
    "slots",
    "slot_length_s",
    "area_m",
    "grid_step_m",
    "altitude_m",
    "cds_m",
    "devices_m",
    "free_moves",
)


def make_pilot(policy: str, scenario: Scenario, uav: int, folder: Path) -> Pilot:
    """Return the pilot of a UAV, numbered from 0.

    Args:
        policy: a folder that was exported, taken as it is; or a run's folder or a released policy.
        scenario: to be flown.
        uav: its number.
        folder: where a run or a released policy is exported to.

    Raises:
        InputError: there is no such policy, it needs what the other UAVs tell, or it was exported for another map.
    """
    optional("onnxruntime")
    from uavaou.onboard.runner import Pilot

    if (Path(policy) / FILES[0]).exists():
        folder = Path(policy)
    else:
        write_policy(load_run(policy, scenario, knows="local"), policy, folder)
    try:
        pilot = Pilot(folder, uav)
    except ValueError as error:
        raise InputError(str(error)) from error
    if pilot.shared:
        raise InputError(f"'{policy}' needs the positions of the other UAVs, which the link does not have")
    told = json.loads(json.dumps(describe_mission(scenario)))
    for name in _MAP:
        if pilot.mission.get(name) != told.get(name):
            raise InputError(f"'{policy}' was exported for another map than '{scenario.name}': {name} differs")
    return pilot
