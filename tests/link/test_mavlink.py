"""Over MAVSDK and UDP, an autopilot that fails in many ways ends at home, landed; the log says why."""

import json
import math
import os
import queue
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.link.conftest import FIELD
from tests.link.fake_autopilot import FakeAutopilot, link
from uavaou.csv_tables import TEXT, read_table
from uavaou.field.geodesy import Projection
from uavaou.link.flight import OVER, LinkedFlight
from uavaou.link.mavsdk_autopilot import connect
from uavaou.link.radio import reported_radio, simulated_radio
from uavaou.onboard.runner import Pilot
from uavaou_cli.main import main

STATION = tuple(map(float, Projection.of(FIELD).to_degrees(np.array([200.0, 100.0]))))
COMMANDING = {  # what moves an aircraft
    link.MAV_CMD_COMPONENT_ARM_DISARM,
    link.MAV_CMD_NAV_TAKEOFF,
    link.MAV_CMD_DO_SET_MODE,
    link.MAV_CMD_DO_REPOSITION,
    link.MAV_CMD_NAV_LAND,
    link.MAV_CMD_NAV_RETURN_TO_LAUNCH,
}
GOTO, LAND, ARM = 192, 21, 400


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
        return number


def fly(make_pilot: Callable[[], Pilot], port: int, **faults: Any) -> tuple[str, FakeAutopilot, list[Any]]:
    notes: list[Any] = []
    radio, names = simulated_radio(FIELD, 0, 0), [FIELD.device_name(device) for device in range(FIELD.devices)]
    with FakeAutopilot(port, STATION, **faults) as fake, connect(f"udp://127.0.0.1:{port}", Projection.of(FIELD)) as up:
        reason = LinkedFlight(make_pilot(), up, radio, names, notes.append, bool, silence_s=2.0).run()
    return reason, fake, notes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "why"),
    [
        ({}, OVER),
        ({"delay_s": 0.1}, OVER),
        ({"loss": 0.2, "seed": 1}, OVER),
        ({"loss": 0.1, "delay_s": 0.05, "seed": 2}, OVER),
        ({"refuses": {GOTO: 99}}, "3 commands in a row refused: goto_location: COMMAND_DENIED"),
        ({"refuses": {GOTO: 2, ARM: 1}}, OVER),
        ({"refuses": {LAND: 9}}, OVER),
        ({"refuses": {ARM: 9}}, "3 commands in a row refused: arm: COMMAND_DENIED"),
        ({"low_battery_s": 2.0}, "battery"),
        ({"silent": (2.0, 6.0)}, "link lost"),
        ({"silent": (2.0, 6.0), "deaf": True}, "link lost"),
    ],
)
def test_it_ends_at_home(faults: dict[str, Any], why: str, port: int, make_pilot: Callable[[], Pilot]) -> None:
    reason, fake, notes = fly(make_pilot, port, **faults)
    assert why in reason
    assert fake.landed
    assert not fake.armed
    assert np.hypot(fake.x, fake.y) < 10
    assert notes[-1].event == "the motors are off"
    assert any(reason in note.event for note in notes)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, scenario in {
        "field": FIELD,
        "finer": FIELD.replace(grid_step_m=50),
        "nowhere": FIELD.replace(georeference=None),
    }.items():
        Path(f"{name}.yaml").write_text(json.dumps(scenario.to_dict()))
    return tmp_path


def command(exported: Path, port: int, *options: str) -> int:
    return main(["link", f"udp://127.0.0.1:{port}", "--scenario", "field.yaml", "--policy", str(exported), *options])


def test_without_arm_nothing_is_commanded(
    place: Path, exported: Path, port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with FakeAutopilot(port, (47.1, 8.5)) as fake:
        assert command(exported, port, "--out", "log") == 0
    assert not COMMANDING & set(fake.commands)
    printed = capsys.readouterr().out
    assert "the devices are simulated" in printed
    assert "dry run: nothing is armed and nothing commanded" in printed
    assert "m from the station (200, 100) m of --uav 0" in printed
    assert len(read_table(Path("log/uav_0.csv"), {"slot": TEXT})) == 32


@pytest.mark.slow
def test_an_interrupt_brings_it_home(
    place: Path, exported: Path, port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with FakeAutopilot(port, STATION) as fake:

        def interrupt() -> None:
            while math.hypot(fake.x, fake.y) < 50:
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGTERM)  # Ctrl-C is ignored where tests run in the background

        threading.Thread(target=interrupt, daemon=True).start()
        assert command(exported, port, "--arm", "--out", "log") == 143
    assert fake.landed
    assert np.hypot(fake.x, fake.y) < 10
    assert link.MAV_CMD_NAV_LAND in fake.commands
    log = read_table(Path("log/uav_0.csv"), {"slot": TEXT, "event": TEXT}).fillna("")
    assert log["event"].iloc[-1] == "the motors are off"
    assert "coming home: interrupted" in set(log["event"])
    assert len(set(log["slot"])) < 32
    assert "coming home: interrupted" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--uav", "1"], "--uav 1: scenario 'quickstart' has UAVs from 0 to 0"),
        (["--scenario", "finer.yaml"], "was exported for another map than 'quickstart': grid_step_m differs"),
        (["--scenario", "nowhere.yaml"], "does not say where it lies"),
        (["--devices", "radio"], "unknown --devices 'radio'"),
        (["--policy", "best-first"], "best-first"),
        ([], "no autopilot was heard"),
    ],
)
def test_what_cannot_be_flown_is_one_line(
    options: list[str],
    message: str,
    place: Path,
    exported: Path,
    port: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uavaou.link.mavsdk_autopilot.connect.__wrapped__.__defaults__", (0.2,))
    assert command(exported, port, *options) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1


def test_a_missing_package_is_one_line(
    place: Path, exported: Path, port: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mavsdk.mavsdk", None)
    assert command(exported, port) == 2
    assert capsys.readouterr().err == "uavaou: 'mavsdk' 4 is not installed: pip install 'uavaou[link]'\n"


def test_a_receiver_reports_what_it_hears() -> None:
    lines: queue.Queue[str] = queue.Queue()
    radio, heard = reported_radio(iter(lines.get, ""), ["tank 3", "mast", "well"]), np.zeros(3, dtype=bool)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        for line in ("{", '{"heard": 3}', '{"heard": ["nobody", "tank 3"]}', '{"heard": [2]}'):
            lines.put(line)
        while not heard[2]:
            heard |= radio(1, np.zeros(2))
    assert heard.tolist() == [True, False, True]
    assert len(warned) == 2
    assert not radio(2, np.zeros(2)).any()
    lines.put("")
