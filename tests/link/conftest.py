"""A policy with preferences, exported for one UAV on a map that has a place on the earth."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.onboard.policies import QUICK, lively
from uavaou.onboard.export import write_policy
from uavaou.onboard.runner import Pilot

HOME = (47.0, 8.5)
FIELD = QUICK.replace(
    uavs=1,
    altitudes_m=[80],
    cds_m=[[200, 100]],
    slots=32,
    slot_length_s=0.3,
    speed_m_s=500,
    flight_time_budget_s=100,
    no_fly=[
        {"polygon_m": [[80, 180], [120, 180], [120, 220], [80, 220]]},  # closes a cell
        {"polygon_m": [[245, 150], [255, 150], [255, 250], [245, 250]]},  # closes a leg
    ],
    georeference={"latitude": HOME[0], "longitude": HOME[1]},
)


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    trained = lively(scenario=FIELD, views=1, network="set", observation="local", collection="auto", pull=12.0)
    write_policy(trained, "mine", folder)
    return folder


@pytest.fixture(scope="session")
def make_pilot(exported: Path) -> Callable[[], Pilot]:
    def make() -> Pilot:
        pilot = Pilot(exported, 0)
        pilot.mission["slots"] = 16  # a short mission
        return pilot

    return make
