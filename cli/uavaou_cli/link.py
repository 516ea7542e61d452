"""``uavaou link``: fly one UAV by an exported policy over MAVLink, or show what would be flown."""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaou.errors import InputError
from uavaou.evaluation.seeds import LARGEST_SEED
from uavaou_cli.options import Changes, number, option, writable_file
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.tables import show

if TYPE_CHECKING:
    from uavaou.field.geodesy import Projection
    from uavaou.link.flight import Leg, Radio
    from uavaou.scenario import Scenario

_COLUMNS = ("slot", "x_m", "y_m", "latitude", "longitude", "height_m", "to_x_m", "to_y_m", "arrived", "heard",
            "collected", "mean_aou_slots", "battery_percent", "event")  # fmt: skip

_DRY = "dry run: nothing is armed and nothing commanded (--arm flies); what would be commanded:"


def link(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="Of the autopilot: udp://0.0.0.0:14540, serial:///dev/ttyACM0:57600.")
    ],
    scenario: Annotated[str, option("The map: a YAML file with a georeference.")],
    uav: Annotated[int, number("Which UAV of the scenario this aircraft is, from 1.", 1)] = 1,
    policy: Annotated[
        str, option("A released policy, a run's folder, or a folder that `uavaou export` wrote.", "RUN")
    ] = "any-map",
    arm: Annotated[bool, typer.Option("--arm", help="Fly. Without it nothing is armed and nothing commanded.")] = False,
    devices: Annotated[
        str,
        option(
            "Which devices are heard: simulated, by the channel model; or as a receiver reports, in lines of JSON on "
            "stdin or in datagrams to this machine (docs/link.md). [default: simulated]",
            "simulated|stdin|udp://HOST:PORT",
        ),
    ] = "simulated",
    silence: Annotated[float, number("Come home after as long without telemetry, in s.", 0.1, metavar="S")] = 5.0,
    battery: Annotated[float, number("Come home at this charge, in %.", 0, 100, "PERCENT")] = 25.0,
    seed: Annotated[int, number("Of the simulated channel.", 0, LARGEST_SEED)] = 0,
    out: Annotated[
        Path | None, option("The log. [default: results/<scenario>/link/<policy>/uav-<n>.csv]", "FILE")
    ] = None,
    set_: Changes = None,
) -> None:
    """Fly one UAV by a policy over MAVLink, in closed loop.

    Without --arm it connects, checks what the aircraft tells, and prints what would be commanded in each slot.
    It comes home at the end of the mission, at Ctrl-C, when the link is lost, when commands are refused, and when the
    battery is low. A second Ctrl-C commands the autopilot's own return and leaves.
    """
    from uavaou.field.geodesy import Projection
    from uavaou.link.autopilot import Imagined
    from uavaou.link.flight import OVER, LinkedFlight, Released
    from uavaou.link.mavsdk_autopilot import connect
    from uavaou.link.pilot import make_pilot
    from uavaou.runs.interrupt import Interrupts
    from uavaou.runs.names import flight_folder, scenario_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    base = Scenario.load(scenario)
    flown = overrides.of_scenario(base)
    projection = Projection.of(flown)
    place = Path("results") / scenario_folder(base, overrides.scenario) / "link" / flight_folder([policy])
    log = _Log(flown, projection, out or place / f"uav-{uav}.csv")
    pilot = make_pilot(policy, flown, uav - 1, place / "policy")
    radio = _radio(devices, flown, uav - 1, seed)
    with connect(url, projection) as aircraft, Interrupts(quiet=True) as interrupts:
        flight = LinkedFlight(pilot, aircraft, radio, log, silence, battery, lambda: interrupts.received)
        if not arm:
            show([*(f"it could not fly now: {fault}" for fault in flight.faults()), _DRY])
            flight = LinkedFlight(pilot, Imagined(flight.station), radio, log, stopped=lambda: interrupts.received)
        log.kept = arm
        try:
            reason = flight.run()
        except Released as error:
            reason = str(error)
            log(f"the link commands nothing more: {reason}")
    log.write()
    show([log.path])
    if reason != OVER:
        raise typer.Exit(1 if interrupts.received is None else 128 + interrupts.received)


def _radio(devices: str, scenario: Scenario, uav: int, seed: int) -> Radio:
    from uavaou.link.radio import ReportedRadio, SimulatedRadio, datagrams

    if devices == "simulated":
        show(["the devices are simulated: the channel model says which ones are heard"])
        return SimulatedRadio(scenario, uav, seed)
    names = [scenario.device_name(device) for device in range(scenario.devices)]
    if devices == "stdin":
        return ReportedRadio(sys.stdin, names)
    address = re.fullmatch(r"udp://([^:/]*):(\d{1,5})", devices)
    if address is None:
        raise InputError(f"--devices {devices}: expected simulated, stdin or udp://HOST:PORT")
    return ReportedRadio(datagrams(address[1], int(address[2])), names)


class _Log:
    """Prints what happens, and keeps it as a table at ``path``, in flight after each slot."""

    def __init__(self, scenario: Scenario, projection: Projection, path: Path) -> None:
        writable_file(path)
        self.path, self.kept = path, False
        self._scenario, self._projection = scenario, projection
        self._rows: list[tuple[object, ...]] = []

    def __call__(self, event: Leg | str) -> None:
        row, line = (("",) * (len(_COLUMNS) - 1) + (event,), event) if isinstance(event, str) else self._of(event)
        self._rows.append(row)
        with suppress(OSError):  # nobody reads it any more, and the flight goes on
            show([line])
        if self.kept:
            self.write()

    def write(self) -> None:
        from uavaou.csv_tables import write_csv

        write_csv(self.path, _COLUMNS, self._rows)

    def _of(self, leg: Leg) -> tuple[tuple[object, ...], str]:
        state, minutes = leg.state, self._scenario.slot_length_s / 60
        at, to = state.at_m.tolist(), leg.target_m.tolist()
        heard, collected = (
            ", ".join(self._scenario.device_name(device) for device in flags.nonzero()[0].tolist())
            for flags in (leg.heard, leg.collected)
        )
        degrees = self._projection.to_degrees(state.at_m).tolist()
        row = (leg.slot, *at, *(f"{angle:.7f}" for angle in degrees), state.height_m, *to, int(leg.arrived), heard,
               collected, leg.age_slots, state.battery_percent, leg.reason)  # fmt: skip
        line = (
            f"slot {leg.slot:3}  at ({at[0]:.0f}, {at[1]:.0f}) m  to ({to[0]:.0f}, {to[1]:.0f}) m"
            f"{'' if leg.arrived else ' (late)'}  AoU {leg.age_slots:.1f} slots ({leg.age_slots * minutes:.1f} min)  "
            f"heard: {heard or 'none'}"
        )
        return row, line
