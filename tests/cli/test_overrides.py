"""``--set KEY=VALUE``."""

from __future__ import annotations

from uavaou_cli.overrides import parse_overrides


def test_overrides_reach_into_ranges_and_leave_the_rest() -> None:
    from uavaou.scenario import Scenario

    items = ["scenario.bandwidth_hz.low=14e3", "scenario.layout_seed=7", "algorithm.learning_rate=1e-4"]
    overrides = parse_overrides(items)
    base = Scenario.load("quickstart")
    changed = overrides.of_scenario(base).to_dict()
    assert changed == base.to_dict() | {"bandwidth_hz": {"low": 14e3, "high": 2e4}, "layout_seed": 7}
    assert overrides.of_algorithm("ippo").model_dump()["learning_rate"] == 1e-4
