"""``uavaou scenarios``: the presets."""

from __future__ import annotations

from uavaou_cli.tables import show


def scenarios() -> None:
    """List the scenarios that come with uavaou."""
    from uavaou.scenario import Scenario
    from uavaou.zoo import zoo_names
    from uavaou_cli.tables import scenario_lines

    show(scenario_lines([Scenario.load(name) for name in zoo_names("scenarios")]))
