"""``--set KEY=VALUE``."""

from __future__ import annotations

import pytest

from uavaou_cli.overrides import parse_overrides, parse_value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7", 7),
        ("1e-4", 1e-4),
        ("-2.5", -2.5),
        ("true", True),
        ("rician", "rician"),
        ("none", "none"),
        ("[1e1, 2, [x]]", [10.0, 2, ["x"]]),
        ("{low: 15e3, high: 20000}", {"low": 15000.0, "high": 20000}),
        ("[unclosed", "[unclosed"),
    ],
)
def test_values_read_as_a_person_means_them(text: str, value: object) -> None:
    read = parse_value(text)
    assert read == value
    assert type(read) is type(value)


def test_overrides_reach_into_ranges_and_leave_the_rest() -> None:
    from uavaou.scenario import Scenario

    items = ["scenario.bandwidth_hz.low=14e3", "scenario.layout_seed=7", "algorithm.learning_rate=1e-4"]
    overrides = parse_overrides(items)
    base = Scenario.load("quickstart")
    changed = overrides.of_scenario(base).to_dict()
    assert changed == base.to_dict() | {"bandwidth_hz": {"low": 14e3, "high": 2e4}, "layout_seed": 7}
    assert overrides.of_algorithm("ippo").model_dump()["learning_rate"] == 1e-4
