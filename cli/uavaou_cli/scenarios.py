"""``uavaou scenarios``: the presets, and ``uavaou audit``: whether the numbers of one fit together."""

from uavaou_cli.options import ScenarioName
from uavaou_cli.tables import aligned, show, wrapped


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


def audit(scenario: ScenarioName) -> None:
    """Check a scenario: the link budget of every device, and what does not fit together."""
    from uavaou.reports import audit as report
    from uavaou.scenario import Scenario

    show(report.audit_lines(report.audit(Scenario.load(scenario))))
