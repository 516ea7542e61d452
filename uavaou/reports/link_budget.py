"""The link budget of a scenario: which device each UAV reaches from which cell, and with what probability."""

from dataclasses import dataclass

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.scenario import Layout, Scenario
from uavaou.world.channel import rate
from uavaou.world.coverage import coverage_probability, coverage_radius, mean_snr
from uavaou.world.flight import Flight, closed_cells

_BLOCK = 2_000_000  # probabilities held at a time


@dataclass(frozen=True)
class LinkBudget:
    """Which UAV reaches which device, over the cells it can fly to; probabilities are of R >= R_min in one slot."""

    radius: Floats  # (U, I) m, without fading; nan where out of range even right below
    best: Floats  # (U, I), over the cells
    mean: Floats  # (I,), over UAVs and cells
    lowest: Floats  # (I,), over UAVs and cells
    at_cds: Floats  # (I,), best over the UAVs, each over its CDS
    in_range: Bools  # (U, I), from some cell, without fading
    in_range_and_back: Bools  # (I,), likewise from a cell that the UAV can fly to and come home from
    shut_off: Bools  # (I,), in range without fading from cells alone that UAVs may not or cannot fly to
    cells: Ints  # (I,), cells from which some UAV has it in range without fading
    far_rate: Floats  # (I,) bit/s, without fading, at the cell and UAV farthest away


def link_budget(scenario: Scenario, layout: Layout) -> LinkBudget:
    """Compute the link budget of all devices of ``layout``, some devices at a time."""
    size = max(1, _BLOCK // (scenario.uavs * scenario.columns * scenario.rows))
    blocks = []
    for first in range(0, scenario.devices, size):
        part = slice(first, first + size)
        devices = Layout(*(values[part] for values in vars(layout).values()))
        blocks.append(vars(_budget_of(scenario, devices)))
    return LinkBudget(**{name: np.concatenate([block[name] for block in blocks], axis=-1) for name in blocks[0]})


def _budget_of(scenario: Scenario, layout: Layout) -> LinkBudget:
    probability = coverage_probability(scenario, layout)  # (U, X, Y, I)
    # R_min met without fading, wherever the scenario fades: the indicator that `fading: none` gives.
    snr_met = coverage_probability(scenario.replace(fading="none"), layout) > 0  # (U, X, Y, I)
    closed, behind = closed_cells(scenario), snr_met.any(axis=(0, 1, 2))  # (U, C) or None, (I,)
    lowest, share = probability.min(axis=(0, 1, 2)), 1.0
    if closed is not None:
        shut, share = closed.reshape(*snr_met.shape[:3], 1), 1 - closed.mean()
        lowest = np.where(shut, 1.0, probability).min(axis=(0, 1, 2))
        probability, snr_met = np.where(shut, 0.0, probability), snr_met & ~shut
    uav = np.arange(scenario.uavs)
    columns, rows = scenario.cds_cells.T
    return LinkBudget(
        radius=coverage_radius(scenario, layout),
        best=probability.max(axis=(1, 2)),
        mean=probability.mean(axis=(0, 1, 2)) / share,
        lowest=lowest,
        at_cds=probability[uav, columns, rows].max(axis=0),
        in_range=np.asarray(snr_met.any(axis=(1, 2))),
        in_range_and_back=np.asarray((snr_met & there_and_back(scenario)[..., None]).any(axis=(0, 1, 2))),
        shut_off=np.asarray(behind & ~snr_met.any(axis=(0, 1, 2))),
        cells=np.count_nonzero(snr_met.any(axis=0), axis=(0, 1)),
        far_rate=_far_rate(scenario, layout),
    )


def _far_rate(scenario: Scenario, layout: Layout) -> Floats:
    """The rate without fading at the farthest cell from each device, at the UAV farthest away, (I,) bit/s."""
    x, y = (scenario.columns - 1) * scenario.grid_step_m, (scenario.rows - 1) * scenario.grid_step_m
    corners = np.array([[0.0, 0.0], [x, 0.0], [0.0, y], [x, y]])  # (4, 2) m; the farthest cell is one of them
    return rate(layout.bandwidth, mean_snr(scenario, layout, corners).min(axis=(0, 1)))


def there_and_back(scenario: Scenario) -> Bools:
    """The cells that each UAV can fly to and come home from in one mission, (U, X, Y)."""
    flight = Flight(scenario)
    steps = flight.home.reshape(-1, scenario.columns, scenario.rows)  # (U, X, Y)
    moves = np.minimum(flight.budget, scenario.slots - 1)  # (U,); the move of slot K has no effect
    return np.asarray(2 * steps <= moves[:, None, None])
