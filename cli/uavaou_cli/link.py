"""``uavaou link``: fly one UAV by an exported policy over MAVLink, or show what would be flown."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import LARGEST_SEED
from uavaou_cli.options import choice, number, option, writable_folder
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.link.flight import Entry

_SIMULATED = "the devices are simulated: the channel model says which ones are heard"
_DRY = "dry run: nothing is armed and nothing commanded (--arm flies); what would be commanded:"


def link(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="Of the autopilot: udp://0.0.0.0:14540, serial:///dev/ttyACM0:57600.")
    ],
    scenario: Annotated[str, option("The map: a YAML file with a georeference.")],
    uav: Annotated[int, number("Which UAV of the scenario this aircraft is, from 0 as in its route files.", 0)] = 0,
    policy: Annotated[
        str, option("A released policy, a run's folder, or a folder that `uavaou export` wrote.", "RUN")
    ] = "any-map",
    arm: Annotated[bool, typer.Option("--arm", help="Fly. Without it nothing is armed and nothing commanded.")] = False,
    devices: Annotated[
        str,
        choice(
            "Which are heard: by the channel model, or as a receiver reports on stdin in lines of JSON.",
            "simulated",
            "stdin",
        ),
    ] = "simulated",
    silence: Annotated[float, number("Come home after as long without telemetry, in s.", 0.1, metavar="S")] = 5.0,
    seed: Annotated[int, number("Of the simulated channel.", 0, LARGEST_SEED)] = 0,
    out: Annotated[Path | None, option("Of the log and the policy. [default: results/<scenario>/link]", "DIR")] = None,
) -> None:
    """Fly one UAV by a policy over MAVLink, in closed loop.

    Without --arm it connects, checks what the aircraft tells, and prints what would be commanded in each slot.
    It comes home at the end of the mission, at Ctrl-C, when the link is lost, when commands are refused, and when the
    autopilot warns of its battery. A second Ctrl-C commands the autopilot's own return and leaves.
    """
    import pandas as pd

    from uavaou.csv_tables import write_table
    from uavaou.field.geodesy import Projection
    from uavaou.link.flight import OVER, Entry, LinkedFlight
    from uavaou.link.mavsdk_autopilot import connect
    from uavaou.link.pilot import make_pilot
    from uavaou.link.radio import reported_radio, simulated_radio
    from uavaou.runs.interrupt import Interrupts
    from uavaou.runs.names import scenario_folder
    from uavaou.scenario import Scenario

    flown = Scenario.load(scenario)
    projection = Projection.of(flown)
    folder = out or Path("results") / scenario_folder(flown) / "link"
    writable_folder(folder)
    path = folder / f"uav_{uav}.csv"
    if uav >= flown.uavs:
        raise InputError(f"--uav {uav}: scenario '{flown.name}' has UAVs from 0 to {flown.uavs - 1}")
    pilot = make_pilot(policy, flown, uav, folder / "policy")
    names = [flown.device_name(device) for device in range(flown.devices)]
    simulated, entries = devices == "simulated", list[Entry]()
    radio = simulated_radio(flown, uav, seed) if simulated else reported_radio(sys.stdin, names)

    def note(entry: Entry) -> None:
        entries.append(entry)
        with suppress(OSError):  # nobody reads it any more, and the flight goes on
            show([_line(entry)])
        if arm:
            write_table(path, pd.DataFrame(entries, columns=Entry._fields))

    with connect(url, projection) as aircraft, Interrupts(quiet=True) as interrupts:
        flight = LinkedFlight(pilot, aircraft, radio, names, note, lambda: interrupts.received, silence)
        if simulated:
            show([_SIMULATED])
        if not arm:
            show([*(f"it could not fly now: {fault}" for fault in flight.faults()), _DRY])
        reason = flight.run() if arm else flight.rehearse()
    write_table(path, pd.DataFrame(entries, columns=Entry._fields))
    show([path])
    if reason != OVER:
        raise typer.Exit(1 if interrupts.received is None else 128 + interrupts.received)


def _line(entry: Entry) -> str:
    if entry.x_m is None:
        return entry.event
    late = "" if entry.arrived else " (late)"
    return (
        f"slot {entry.slot:3}  at ({entry.x_m:.0f}, {entry.y_m:.0f}) m  to ({entry.to_x_m:.0f}, {entry.to_y_m:.0f}) m"
        f"{late}  AoU {entry.mean_aou_slots:.1f} slots  heard: {entry.heard or 'none'}"
    )
