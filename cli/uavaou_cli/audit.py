"""``uavaou audit``: the link budget of a scenario, and whether its numbers fit together."""

from __future__ import annotations

from uavaou_cli.options import ScenarioArgument
from uavaou_cli.tables import show


def audit(scenario: ScenarioArgument) -> None:
    """Check a scenario: the link budget of every device, and what does not fit together."""
    from uavaou.reports.audit import audit as audit_scenario
    from uavaou.reports.audit import audit_lines
    from uavaou.scenario import Scenario

    show(audit_lines(audit_scenario(Scenario.load(scenario))))
