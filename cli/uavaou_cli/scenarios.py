"""``uavaou scenarios``: the presets, and ``uavaou audit``: whether the numbers of one fit together."""

from pathlib import Path
from typing import Annotated

import typer

from uavaou_cli.options import Changes, ScenarioName, ScenarioOption, needed_scenario, option, writable_folder
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.tables import aligned, show, wrapped

FOUND_ERRORS = 1


def scenarios() -> None:
    """List the scenarios that come with uavaou."""
    from uavaou.scenario import Scenario
    from uavaou.zoo import zoo_names

    rows, words = [("scenario", "UAVs", "devices", "slots", "area")], [""]
    for scenario in map(Scenario.load, zoo_names("scenarios")):
        area = f"{scenario.area_x_m:g} m x {scenario.area_y_m:g} m"
        rows.append((scenario.name, str(scenario.uavs), str(scenario.devices), str(scenario.slots), area))
        words.append(scenario.description)
    for sizes, description in zip(aligned(rows), words, strict=True):
        show([sizes, *wrapped(description, indent="  ")])
    show(["", "paper is the default; the path of a YAML file can stand for a name"])


def audit(
    scenario: ScenarioName = None,
    scenario_option: ScenarioOption = None,
    out: Annotated[Path | None, option("Also draw the coverage of each device on a map.", "DIR")] = None,
    set_: Changes = None,
) -> None:
    """Check a scenario: the link budget of every device, and what does not fit together.

    The exit code is 1 where there are errors.
    """
    from uavaou.reports import audit as report
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("an audit trains nothing")
    if out is not None:
        writable_folder(out)
    found = report.audit(overrides.of_scenario(Scenario.load(needed_scenario(scenario, scenario_option))))
    show(report.audit_lines(found))
    if out is not None:
        from uavaou.reports.coverage_map import plot_coverage

        show(["", *plot_coverage(found, out)])
    if found.of_level("error"):
        raise typer.Exit(FOUND_ERRORS)  # so that `uavaou audit x.yaml && uavaou train x.yaml` stops here
