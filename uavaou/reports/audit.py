"""The audit of a scenario: its link budget device by device, and what the checks find, as lines of text."""

import textwrap
from dataclasses import dataclass

import numpy as np

from uavaou.reports.audit_checks import Finding, Level, findings, plain
from uavaou.reports.audit_operations import operations_findings
from uavaou.reports.link_budget import LinkBudget, link_budget
from uavaou.scenario import Layout, Scenario

_LEVELS: tuple[Level, ...] = ("error", "warning", "note")
_WIDTH = 110  # characters of a line of text
_DEVICES_SHOWN = 200
_RADII_SHOWN = 5  # with more UAVs the table shows the widest radius alone


@dataclass(frozen=True)
class Audit:
    """The link budget of a scenario, and the findings: errors first, then warnings, then notes."""

    scenario: Scenario
    layout: Layout
    budget: LinkBudget
    findings: tuple[Finding, ...]

    def of_level(self, level: Level) -> list[Finding]:
        """The findings of one level."""
        return [finding for finding in self.findings if finding.level == level]


def audit(scenario: Scenario) -> Audit:
    """Compute the link budget of ``scenario`` and check that its quantities fit together.

    A scenario with ``layout: resample`` is audited on the layout of its ``layout_seed``, and a note says so.
    """
    layout = scenario.draw_layout()
    budget = link_budget(scenario, layout)
    every = [*findings(scenario, layout, budget), *operations_findings(scenario, layout, budget)]
    found = sorted(every, key=lambda finding: _LEVELS.index(finding.level))
    return Audit(scenario, layout, budget, tuple(found))


def audit_lines(result: Audit) -> list[str]:
    """Write an audit as lines of plain text: the findings under the table of devices."""
    scenario = result.scenario
    in_range = "R >= R_min holds" if scenario.rate_min_bit_s is not None else f"{scenario.threshold} is met"
    lines = [
        f"Scenario {scenario.name}: {scenario.devices} devices, {scenario.uavs} UAVs, "
        f"{scenario.columns} x {scenario.rows} cells of {plain(scenario.grid_step_m)} m, "
        f"{scenario.slots} slots of {plain(scenario.slot_length_s)} s",
        "",
        *_table(result),
        *([f"({_DEVICES_SHOWN} devices that are hardest to reach)"] if scenario.devices > _DEVICES_SHOWN else []),
        "",
        f"radius: on the ground, in m, within which {in_range} without fading; - out of range even right below",
        "cells: grid cells from which some UAV is within that radius",
        f"P: probability that {in_range} in a slot, over all UAVs and cells",
        "",
    ]
    for finding in result.findings:
        text = finding.message + (f" Change: {finding.change}." if finding.change else "")
        label = f"{finding.level:<8} "
        indent = " " * len(label)
        lines += textwrap.wrap(text, _WIDTH, initial_indent=label, subsequent_indent=indent, break_on_hyphens=False)
    counts = {level: len(result.of_level(level)) for level in _LEVELS}
    return [*lines, "", ", ".join(f"{n} {level}{'' if n == 1 else 's'}" for level, n in counts.items())]


def _table(result: Audit) -> list[str]:
    """The devices as aligned columns, the heading first: all, or the hardest to reach where there are very many."""
    layout, budget, altitudes = result.layout, result.budget, result.scenario.altitudes_m
    each = len(altitudes) <= _RADII_SHOWN
    radii = [f"radius@{plain(altitude)}m" for altitude in altitudes] if each else ["widest radius"]
    heading = ["device", "x m", "y m", "B kHz", "P mW", "k", *radii, "cells", "P mean", "P best"]
    rows = [heading]
    for i in sorted(np.argsort(budget.mean, kind="stable")[:_DEVICES_SHOWN]):
        bandwidth_khz = layout.bandwidth[i] / 1e3
        radius = budget.radius[:, i] if each else [np.fmax.reduce(budget.radius[:, i])]  # m
        rows.append(
            [
                str(i) if result.scenario.device_names is None else result.scenario.device_name(i),
                *(f"{place:.0f}" for place in layout.positions[i]),
                f"{bandwidth_khz:.4g}" if bandwidth_khz < 1e4 else f"{bandwidth_khz:.0f}",
                f"{layout.transmit_power[i] * 1e3:.3g}",
                str(layout.update_period[i]),
                *("-" if np.isnan(metres) else f"{metres:.0f}" for metres in radius),
                str(budget.cells[i]),
                f"{budget.mean[i]:.4f}",
                f"{budget.best[:, i].max():.4f}",
            ]
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(heading))]
    return ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
