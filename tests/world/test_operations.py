"""Missions as they really go: the World against a literal mission, and what must hold in every mission."""

import hashlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.random_missions import ITEMS, with_items
from tests.strategies import random_actions, scenarios, seeds
from tests.world.literal_operations import FULL, LiteralOperations
from uavaou import Scenario, World
from uavaou.mission_fields import RotaryWing


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
        spare = operations.spare(world.cells, world.flown, world.slot)
        assert spare[lane].tolist() == [mission.spare(u) for u in range(scenario.uavs)]
    if operations.weather is not None:
        np.testing.assert_allclose(operations.weather.wind[lane], mission.wind, rtol=1e-9, atol=1e-9)
    if (knowledge := operations.knowledge) is not None:
        assert knowledge.heard[lane].tolist() == mission.heard
        assert [[tuple(cell) for cell in of] for of in knowledge.cells[lane].tolist()] == mission.seen_at
        assert knowledge.until[lane].tolist() == mission.until
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
    if world.operations.off:
        assert reward == pytest.approx(-seen["age_sum"].sum(), rel=1e-12)


def compare(scenario: Scenario, seed: int, lanes: int) -> None:
    """Play a batch under random actions beside its literal missions."""
    world, rng = World(scenario, lanes, seed), np.random.default_rng(seed)
    literal = [LiteralOperations(scenario, world, lane) for lane in range(lanes)]
    selects = rng.random() < 0.5
    while not world.done:
        snr = world.snr
        gains = snr / world.channel.mean_snr(world.positions)
        for lane, mission in enumerate(literal):
            mission.open()
            np.testing.assert_allclose(snr[lane], mission.snr(gains[lane]), rtol=1e-9)
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
    metrics, measures = world.metrics(), world.measures()
    tau, slots = world.scenario.slot_length_s, world.scenario.slots
    for lane, mission in enumerate(literal):
        # The paper's, whatever the objective.
        assert metrics.reward[lane] == pytest.approx(mission.reward_sum, rel=1e-12)
        assert metrics.mean_aou_s[lane] == pytest.approx(-mission.reward_sum / slots, rel=1e-12)
        assert metrics.device_communications[lane].tolist() == mission.communications
        assert metrics.communications[lane] == sum(mission.communications)
        assert metrics.devices_served[lane] == sum(count > 0 for count in mission.communications)
        of_sorties = [more * mission.zeta(u, 0) for u, more in enumerate(mission.sorties)]
        flown = [mission.zeta(u, steps) - mission.zeta(u, 0) for u, steps in enumerate(mission.flown)]
        assert metrics.flight_time_s[lane] == pytest.approx(np.add(of_sorties, flown))
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


@settings(max_examples=120)
@given(scenario=scenarios(), seed=seeds)
def test_a_mission_of_the_paper_equals_a_literal_one(scenario: Scenario, seed: int) -> None:
    compare(scenario, seed, lanes=3)


@pytest.mark.parametrize("preset", ["tiny", "quickstart"])
def test_presets_equal_a_literal_mission(preset: str) -> None:
    compare(Scenario.load(preset), seed=1, lanes=2)


# -- what must hold in every mission


@settings(max_examples=100)
@given(scenario=operated(must="battery"), seed=seeds)
def test_no_battery_runs_dry_and_every_uav_comes_home(scenario: Scenario, seed: int) -> None:
    world, rng = World(scenario, 6, seed), np.random.default_rng(seed)
    assert world.operations.batteries is not None
    assert scenario.energy is not None
    ever_failed = np.zeros((6, scenario.uavs), dtype=np.bool_)
    while not world.done:
        assert world.allowed_moves.any(axis=-1).all()
        assert (world.operations.batteries.charge >= round(FULL * scenario.energy.reserve)).all()
        ever_failed |= world.failed
        world.step(random_actions(rng, 6, scenario.uavs, scenario.devices)[0])
    assert world.stepped is not None
    home = (world.stepped.positions == np.array(scenario.cds_m)).all(axis=-1)  # (N, U)
    assert (home | ever_failed).all()
    assert (home | world.stepped.failed).all()  # one that is repaired in time is home, too


@settings(max_examples=60)
@given(scenario=scenarios(max_slots=25), seed=seeds, data=st.data())
def test_what_a_failed_uav_would_collect_is_lost_and_nothing_else(scenario: Scenario, seed: int, data: Any) -> None:
    uav, slot = data.draw(st.integers(0, scenario.uavs - 1)), data.draw(st.integers(1, scenario.slots))
    sound, rng = World(scenario, 4, seed), np.random.default_rng(seed)
    losing = World(scenario.replace(failures=[{"uav": uav, "slot": slot}]), 4, seed)
    others = np.arange(scenario.uavs) != uav
    while not sound.done:
        moves, selections = random_actions(rng, 4, scenario.uavs, scenario.devices)
        sound.step(moves, selections)
        losing.step(moves, selections)
        assert sound.stepped is not None
        assert losing.stepped is not None
        assert (losing.stepped.positions[:, others] == sound.stepped.positions[:, others]).all()
        own, kept = sound.stepped.association.collected_by, losing.stepped.association.collected_by
        assert (kept != uav).all() or losing.stepped.slot < slot
        assert (own == kept)[own != uav].all()
    assert (losing.last_collection_by[:, uav] < slot).all()


@settings(max_examples=60)
@given(scenario=operated(), seed=seeds, data=st.data())
def test_a_mission_goes_on_as_it_was_from_any_slot(scenario: Scenario, seed: int, data: Any) -> None:
    stop = data.draw(st.integers(1, scenario.slots))
    world, resumed = World(scenario, 3, seed), World(scenario, 3, seed + 1)
    rng = np.random.default_rng(seed)
    while not world.done:
        if world.slot == stop:
            resumed.load_state_dict(world.state_dict())
        actions = random_actions(rng, 3, scenario.uavs, scenario.devices)
        reward = world.step(*actions)
        if world.slot <= stop:
            continue
        assert (resumed.step(*actions) == reward).all()
        for lane in range(3):
            ours, theirs = world.snapshot(lane), resumed.snapshot(lane)
            assert {name: np.asarray(of).tolist() for name, of in ours.items()} == {
                name: np.asarray(of).tolist() for name, of in theirs.items()
            }
        assert (resumed.allowed_moves == world.allowed_moves).all()
        assert (resumed.collecting == world.collecting).all()
    for name, values in vars(world.measures() or world.metrics()).items():
        assert np.array_equal(vars(resumed.measures() or resumed.metrics())[name], values), name


@settings(max_examples=60)
@given(scenario=operated(), seed=seeds)
def test_no_item_changes_the_fading(scenario: Scenario, seed: int) -> None:
    off = {name: value for name, value in scenario.to_dict().items() if name in Scenario.load("paper").to_dict()}
    plain = World(Scenario.from_dict(off | _radio_of(scenario)), 2, seed)
    world = World(scenario, 2, seed)
    assert plain.operations.off
    for _ in range(2):
        for slot in (1, scenario.slots):
            assert (world.channel.snr(plain.positions, slot) == plain.channel.snr(plain.positions, slot)).all()
        while not world.done:
            world.step(np.zeros((2, scenario.uavs), dtype=np.int64))
        world.reset()  # the streams of the missions go on alike
        plain.reset()


def _radio_of(scenario: Scenario) -> dict[str, Any]:
    names = (
        "path_loss_exponent excess_loss_db antenna_gain_db line_of_sight snr_min_db sensitivity_dbm devices_m "
        "reference_gain_db rate_min_bit_s carrier_frequency_hz layout_seed"
    )
    return {name: value for name, value in scenario.to_dict().items() if name in names.split()}


NEUTRAL: dict[str, dict[str, Any]] = {
    "capacity": {"uplinks_per_slot": 10},
    "battery": {"energy": {"endurance_s": 1e9, "reserve": 0}, "flight_time": "ignore"},  # else a swap renews zeta_max
    "failures": {"failure_probability_per_slot": 0, "failures": []},
    "late failures": {"failures": [{"uav": 0, "slot": 1000}], "devices_silent": [{"device": 0, "start": 1000}]},
    "silence": {"devices_silent": []},
    "links": {"links": {"probability": 0.5}},
    "wind": {"wind": {}, "air_speed_max_m_s": 1e6},
    "measures": {"age_limit_s": 60},
    "objective": {"objective": "aou"},
}


@pytest.mark.parametrize("item", NEUTRAL)
@settings(max_examples=15)
@given(scenario=scenarios(max_slots=20), seed=seeds)
def test_neutral_values_change_nothing(item: str, scenario: Scenario, seed: int) -> None:
    fields = NEUTRAL[item]
    plain = World(scenario.replace(**{"flight_time": "ignore"} if "flight_time" in fields else {}), 3, seed)
    world, rng = World(scenario.replace(**fields), 3, seed), np.random.default_rng(seed)
    while not world.done:
        for name in ("positions", "in_range", "collecting", "allowed_moves", "last_collection_by"):
            assert np.array_equal(getattr(world, name), getattr(plain, name)), name
        actions = random_actions(rng, 3, scenario.uavs, scenario.devices)
        np.testing.assert_allclose(world.step(*actions), plain.step(*actions), rtol=1e-15)
    for name, values in vars(plain.metrics()).items():
        assert np.array_equal(getattr(world.metrics(), name), values) or (item, name) == ("battery", "flight_time_s")


DIGESTS = {"paper": "0bbf7140d39f4a95", "quickstart": "8825a0408cbe374d", "tiny": "6b3d17ff53f3c31f"}


@pytest.mark.parametrize("preset", DIGESTS)
def test_missions_with_all_items_off_are_what_they_were_before_there_were_any(preset: str) -> None:
    scenario, digest = Scenario.load(preset), hashlib.sha256()
    world, rng = World(scenario, 3, 12), np.random.default_rng(5)
    while not world.done:
        shape = (3, scenario.uavs)
        digest.update(world.allowed_moves.tobytes() + world.in_range.tobytes() + world.cells.tobytes())
        selections = rng.random((*shape, scenario.devices)) < 0.7 if world.slot % 3 else None
        world.step(rng.integers(0, 5, shape), selections)
        assert world.stepped is not None
        digest.update(world.stepped.association.collected_by.tobytes() + world.ages.age_slots.tobytes())
        digest.update(world.pending.tobytes())
    assert digest.hexdigest()[:16] == DIGESTS[preset]


@settings(max_examples=60)
@given(scenario=scenarios(max_slots=25), seed=seeds, data=st.data())
def test_nobody_knows_what_was_not_heard(scenario: Scenario, seed: int, data: Any) -> None:
    """The true state of one UAV is another one in a copy of the world: only those hear of it whom a message reached."""
    rng, uavs = np.random.default_rng(seed), scenario.uavs
    world, swapped = (World(scenario.replace(links={"probability": 0.4}), 4, seed) for _ in range(2))
    uav, slot = int(rng.integers(uavs)), int(rng.integers(1, scenario.slots))
    told = np.zeros((4, uavs), dtype=np.bool_)  # (N, U)
    told[:, uav] = True
    while not world.done:
        moves = random_actions(rng, 4, uavs, scenario.devices)[0]
        if world.slot == slot:
            state = world.state_dict()
            state["cells"][:, uav] = np.array([scenario.columns, scenario.rows]) - 1 - state["cells"][:, uav]
            state["pending"], state["age_slots"] = state["pending"] + 1, state["age_slots"] + 5
            state["last_collection"][:] = slot
            state["last_collection_by"][:, uav] = slot
            state["links_collected"][:, uav] = slot - 1
            state["links_cells"][:, uav, uav] = state["cells"][:, uav]
            swapped.load_state_dict(state)
        world.step(moves)
        if world.slot <= slot or world.done:
            continue
        swapped.step(moves)
        ours, theirs = world.operations.knowledge, swapped.operations.knowledge
        assert ours is not None
        assert theirs is not None
        fresh = (ours.heard == world.slot) | (theirs.heard == world.slot)  # (N, to, from): a message of this slot
        told |= (fresh & told[:, None]).any(axis=-1)
        for name in ("heard", "cells", "collected"):
            assert (getattr(ours, name) == getattr(theirs, name))[~told].all(), name


# -- single sentences

TINY = Scenario.load("tiny")
STAY = np.zeros((1, 2), dtype=np.int64)


def out_and_wait(world: World, cell: tuple[int, int], until: int) -> None:
    """Fly UAV 0 to a cell and hover there, as far as it is allowed, until a slot."""
    while world.slot < until:
        x, y = np.array(cell) - world.cells[0, 0]
        world.step(np.array([[3 if x > 0 else 4 if x < 0 else 1 if y > 0 else 2 if y < 0 else 0, 0]]))


@pytest.mark.parametrize("repaired", [9, 11, 12])
def test_a_uav_that_is_repaired_too_late_stays_failed(repaired: int) -> None:
    """It is three steps from its CDS: K = 12, so that a repair in slot 9 is the last one in time."""
    world = World(TINY.replace(cds_m=[[0, 0], [200, 200]], failures=[{"uav": 0, "slot": 5, "until": repaired}]))
    out_and_wait(world, (2, 1), 12)
    world.step(STAY)
    assert world.stepped is not None
    assert world.stepped.failed[0, 0] == (repaired > 9)
    assert (world.stepped.positions[0, 0] == (0, 0)).all() == (repaired == 9)


@pytest.mark.parametrize(("repaired", "home"), [(6, True), (7, False)])
def test_a_uav_that_fails_during_a_swap_may_be_repaired_too_late(repaired: int, home: bool) -> None:
    """It is down in slots 4 to 6, and fails in slot 5: so long as it is failed, its swap waits."""
    changes = {"energy": {"endurance_s": 1000}, "stations_m": [[200, 0]], "swap_time_s": 3 * TINY.slot_length_s}
    failure = {"uav": 0, "slot": 5, "until": repaired}
    world = World(TINY.replace(slots=10, cds_m=[[0, 0], [200, 200]], failures=[failure], **changes))
    out_and_wait(world, (2, 0), 10)
    world.step(STAY)
    assert world.stepped is not None
    assert world.stepped.failed[0, 0] == (not home)
    assert (world.stepped.positions[0, 0] == (0, 0)).all() == home


def test_a_rotary_wing_has_a_reserve_for_the_costliest_wind() -> None:
    """Slow legs with the wind behind cost as much as hovering, more than those in the largest wind."""
    energy = {"model": "rotary-wing", "battery_wh": 20}
    changes = {"speed_m_s": 3, "slot_length_s": 100 / 3, "flight_time": "ignore", "slots": 60}
    world = World(TINY.replace(energy=energy, wind={"deviation_m_s": 1, "correlation": 0}, **changes), 200, 0)
    batteries = world.operations.batteries
    assert batteries is not None
    while not world.done:
        assert (batteries.charge >= FULL // 10).all()
        world.step(np.full((200, 2), (3, 3, 1, 1, 0, 0, 0, 0, 0)[world.slot % 9]))  # out, and hover there


@pytest.mark.parametrize("slots", [3, 7, 9, 11, 150, 225])
def test_an_endurance_of_whole_slots_is_one_of_so_many(slots: int) -> None:
    energy = Scenario.load("paper").replace(energy={"endurance_s": slots * 20 / 3, "reserve": 0}).energy
    assert energy is not None
    assert FULL // int(energy.slot_energy(0.0, 20 / 3)) == slots


def test_the_power_of_the_rotary_wing_is_that_of_its_paper() -> None:
    energy = RotaryWing(model="rotary-wing", battery_wh=80)
    speeds = np.arange(0, 30, 0.1)
    power = [float(energy.power_w(float(speed))) for speed in speeds]
    assert power[0] == pytest.approx(168.49)
    assert speeds[np.argmin(power)] == pytest.approx(10.2, abs=0.1)  # the maximum-endurance speed
    assert min(power) == pytest.approx(126, abs=1)
    assert speeds[1:][np.argmin(power[1:] / speeds[1:])] == pytest.approx(18.3, abs=0.2)  # and the maximum-range speed


@pytest.mark.parametrize(("slot_length_s", "slots"), [(0.2, 3), (0.1, 3), (0.7, 7), (20 / 3, 9)])
def test_an_age_of_the_limit_is_not_above_it(slot_length_s: float, slots: int) -> None:
    limit = round(slots * slot_length_s, 6)
    fields = {"slot_length_s": slot_length_s, "age_limit_s": limit, "rate_min_bit_s": 1e9, "flight_time": "ignore"}
    world = World(TINY.replace(**fields))
    while not world.done:
        world.step(STAY)
    measures = world.measures()
    assert measures is not None
    assert measures.late_share is not None
    assert measures.late_share[0].tolist() == [(12 - slots) / 12] * 4


def test_a_uav_that_cannot_come_home_at_once_steps_to_a_station_along_x_before_y() -> None:
    """Ten slots in the air: it hovers two steps from the station until it must go, six steps from its CDS."""
    battery = {"energy": {"endurance_s": 10 * TINY.slot_length_s, "reserve": 0}, "stations_m": [[400, 400]]}
    big = {"area_x_m": 400, "area_y_m": 400, "slots": 40, "uavs": 1, "altitudes_m": [80], "cds_m": [[0, 0]]}
    world = World(TINY.replace(flight_time="ignore", **big, **battery))
    way = [(3, 3), (3, 3), (3, 3), (4, 3), (4, 4)]  # of the cells in slots 7 to 11
    for move in (3, 3, 3, 1, 1, 1, 0, 0, 0, 0):
        world.step(np.array([[move]]))
        if world.slot >= 7:
            assert tuple(world.cells[0, 0].tolist()) == way[world.slot - 7]
    assert world.operations.batteries is not None
    assert world.operations.batteries.charge[0, 0] < 100  # of FULL: a slot is rounded down
    world.step(STAY[:, :1])  # the swap takes no time
    assert world.operations.batteries.charge[0, 0] == FULL
