"""Missions as they really go: the World against a literal mission, and what must hold in every mission."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.operations import ITEMS, with_items
from tests.strategies import random_actions, scenarios, seeds
from tests.world.literal_operations import FULL, LiteralOperations
from uavaou import Scenario, World


@st.composite
def operated(draw: st.DrawFn, must: str = "", max_slots: int = 40) -> Scenario:
    """Small scenarios with a random combination of items."""
    items = draw(st.sets(st.sampled_from(ITEMS), min_size=1)) | ({must} if must else set())
    return with_items(draw(scenarios(max_slots=max_slots)), np.random.default_rng(draw(seeds)), sorted(items))


def assert_same_slot(world: World, mission: LiteralOperations, lane: int) -> None:
    """Compare the slot that is to be played with the literal one."""
    scenario, operations = world.scenario, world.operations
    assert world.failed[lane].tolist() == mission.failed
    mask = [[mission.allowed(u, move) for move in range(5)] for u in range(scenario.uavs)]
    assert world.allowed_moves[lane].tolist() == mask
    if operations.batteries is not None:
        for name in ("charge", "down", "sortie", "sorties"):
            assert getattr(operations.batteries, name)[lane].tolist() == getattr(mission, name), name
    if operations.weather is not None:
        np.testing.assert_allclose(operations.weather.wind[lane], mission.wind, rtol=1e-9, atol=1e-9)
    if (knowledge := operations.knowledge) is not None:
        assert knowledge.heard[lane].tolist() == mission.heard
        assert [[tuple(cell) for cell in of] for of in knowledge.cells[lane].tolist()] == mission.seen_at
        assert knowledge.collected[lane].tolist() == mission.collections
        fleet = range(scenario.uavs)
        assert knowledge.lost(world.slot)[lane].tolist() == [
            [mission.taken_as_lost(u, v) for v in fleet] for u in fleet
        ]


def assert_same_outcome(outcome: dict[str, Any], world: World, lane: int, reward: float) -> None:
    """Compare the slot that was played."""
    seen = world.snapshot(lane)
    for name in ("slot", "rejected_rate", "rejected_association", "rejected_capacity"):
        assert seen[name] == outcome[name], name
    for name in ("collected_by", "pending", "failed"):
        assert seen[name].tolist() == outcome[name], name
    for name in ("positions", "age_sum", "flight_time", "battery"):
        np.testing.assert_allclose(seen[name], outcome[name], rtol=1e-12, atol=1e-12, err_msg=name)
    assert reward == pytest.approx(outcome["reward"], rel=1e-9, abs=1e-9)


def compare(scenario: Scenario, seed: int, lanes: int) -> None:
    """Play a batch under random actions beside its literal missions."""
    world, rng = World(scenario, lanes, seed), np.random.default_rng(seed)
    literal = [LiteralOperations(scenario, world, lane) for lane in range(lanes)]
    selects = rng.random() < 0.5
    while not world.done:
        snr = world.snr
        for lane, mission in enumerate(literal):
            mission.open()
            assert_same_slot(world, mission, lane)
            in_range = [[mission.in_range(u, i, snr[lane]) for i in mission.things] for u in mission.fleet]
            assert world.in_range[lane].tolist() == in_range
        moves, selections = random_actions(rng, lanes, scenario.uavs, scenario.devices)
        rewards = world.step(moves, selections if selects else None)
        for lane, mission in enumerate(literal):
            chosen = selections[lane] if selects and selections is not None else None
            assert_same_outcome(mission.play(moves[lane], chosen, snr[lane]), world, lane, rewards[lane])
    assert_same_totals(world, literal)


def assert_same_totals(world: World, literal: list[LiteralOperations]) -> None:
    """Compare what is said of whole missions."""
    metrics, measures, tau, slots = (
        world.metrics(),
        world.measures(),
        world.scenario.slot_length_s,
        world.scenario.slots,
    )
    for lane, mission in enumerate(literal):
        assert metrics.reward[lane] == pytest.approx(
            mission.reward_sum, rel=1e-9
        )  # the paper's, whatever the objective
        assert metrics.device_communications[lane].tolist() == mission.communications
        if measures is None:
            continue
        mean, peak, late = (np.array(one) for one in (mission.aoi_sum, mission.aoi_peak, mission.late))
        weights = np.array(mission.weights)
        np.testing.assert_allclose(measures.mean_aoi_s[lane], tau * mean / slots)
        np.testing.assert_allclose(measures.peak_aoi_s[lane], tau * peak)
        assert measures.over_devices("mean_aoi_s")[lane] == pytest.approx(tau * (mean * weights).mean() / slots)
        assert measures.over_devices("peak_aoi_s")[lane] == pytest.approx(tau * (peak * weights).max())
        if measures.late_share is not None:
            np.testing.assert_allclose(measures.late_share[lane], late / slots)


@settings(max_examples=150)
@given(scenario=operated(), seed=seeds)
def test_equals_a_literal_mission(scenario: Scenario, seed: int) -> None:
    compare(scenario, seed, lanes=2)
