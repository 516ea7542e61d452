"""The replay page in a headless Chromium: it plays, scrubs, sorts, and shows the numbers of the recorded mission."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.browser import LEFT_OUT, Browser, find_browser
from tests.reports.screenshots import take
from tests.reports.test_mission_events import ITEMS, fly
from uavaou import Scenario
from uavaou.evaluation.recorded_mission import RecordedMission, record_mission
from uavaou.field.geodesy import Projection
from uavaou.planners import make_planner
from uavaou.reports.replay.page import write_replay

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_browser() is None, reason=LEFT_OUT)]
POLICIES = ("greedy", "best-first")
SLOT = "replay.slot"


@dataclass
class Replay:
    """A page in a browser, and the missions that it replays."""

    browser: Browser
    page: Path
    missions: list[RecordedMission]

    @property
    def slots(self) -> int:
        return self.missions[0].scenario.slots


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replay]:
    place = tmp_path_factory.mktemp("replay")
    scenario = Scenario.load("quickstart").replace(
        uavs=3, altitudes_m=[80, 90, 100], cds_m=[[0, 0], [0, 0], [400, 400]]
    )
    missions = [
        RecordedMission(scenario, name, None, 3, record_mission(scenario, make_planner(name), 3)) for name in POLICIES
    ]
    write_replay(place / "mission.html", dict(zip(POLICIES, missions, strict=True)))
    executable = find_browser()
    assert executable is not None
    browser = Browser(executable, place / "profile")
    yield Replay(browser, place / "mission.html", missions)
    browser.close()


@pytest.fixture
def still(replayed: Replay) -> Iterator[Replay]:
    """The page at its first slot, not playing; what happens there must leave no error."""
    replayed.browser.open(replayed.page, still=True)
    yield replayed
    assert replayed.browser.errors == []


def numbers(text: str) -> list[float]:
    return [float(part.replace(",", "")) for part in re.findall(r"\d[\d,]*(?:\.\d+)?", text)]


def test_the_numbers_are_those_of_the_recorded_mission(still: Replay) -> None:
    browser = still.browser
    browser.click('#devices th button[aria-label="Device"], #devices th:first-child button')  # by device
    for slot in (1, 7, 33, still.slots):
        browser.value(f"replay.seek({slot})")
        assert browser.text("#slot") == f"Slot {slot}"
        for k, mission in enumerate(still.missions):
            ages, carried = mission.age_slots[:slot], mission.recording.communications[:slot]  # (t, I)
            shown = numbers(browser.texts(".aou strong")[k])
            assert shown == [ages[-1].sum()]
            mean, whole, time, served, devices, communications = numbers(browser.texts(".more")[k])
            assert mean == pytest.approx(ages.sum(axis=1).mean(), rel=5e-3, abs=0.051)
            assert whole == pytest.approx(mission.mean_aou_slots, rel=5e-3, abs=0.051)
            seconds = whole * mission.scenario.slot_length_s
            assert time == pytest.approx(seconds if seconds < 90 else seconds / 60, rel=5e-3, abs=0.1 * 7)
            assert [served, devices] == [carried.any(axis=0).sum(), mission.scenario.devices]
            assert communications == carried.sum()
            words = browser.value(f"document.querySelectorAll('canvas')[{k}].getAttribute('aria-label')")
            assert numbers(words.split(f"of {still.slots}: ")[1])[1::3] == [
                round(x) for x in positions(mission, slot)[:, 0]
            ]
            places = browser.value(f"[0, 1, 2].map((u) => replay.maps[{k}].flight.place({slot}, u))")
            np.testing.assert_allclose(places, positions(mission, slot))
            browser.click(f"#table-policies button:nth-child({k + 1})")
            check_table(browser, mission, slot)


def positions(mission: RecordedMission, slot: int) -> np.ndarray:
    """Where the UAVs were, (U, 2) m."""
    return np.asarray(mission.recording.positions[slot - 1])


def check_table(browser: Browser, mission: RecordedMission, slot: int) -> None:
    """Every row of the table, which is sorted by device."""
    recording, devices = mission.recording, mission.scenario.devices
    cells = np.array(browser.texts("#devices tbody td")).reshape(devices, -1)
    ages, carried = mission.age_slots[:slot], recording.communications[:slot]  # (t, I)
    for i, (device, period, age, mean, times, last) in enumerate(cells):
        assert [int(device), int(period)] == [i, recording.layout.update_period[i]]
        assert numbers(age) == [ages[-1, i]]
        assert numbers(mean)[0] == pytest.approx(ages[:, i].mean(), rel=5e-3, abs=0.051)
        assert int(times) == carried[:, i].sum()
        when = np.flatnonzero(carried[:, i])
        expected = f"{when[-1] + 1}, UAV {recording.collected_by[when[-1], i]}" if len(when) else "never"
        assert last == expected


def test_it_plays_to_the_end_and_again(replayed: Replay) -> None:
    browser = replayed.browser
    browser.open(replayed.page, still=False)  # plays at once
    browser.wait(f"{SLOT} > 2")
    assert browser.value("document.querySelector('#play').getAttribute('aria-label')") == "Pause"
    browser.press(" ")
    slot = browser.value(SLOT)
    assert browser.value("new Promise((later) => setTimeout(() => later(replay.slot), 400))") == slot
    assert f"Slot {slot} of" in browser.text("#status")
    browser.value("replay.setSpeed(100)")
    browser.press(" ")
    browser.wait("!replay.playing")
    assert browser.value(SLOT) == replayed.slots
    browser.press("l")
    browser.press(" ")
    browser.wait(f"replay.playing && {SLOT} < {replayed.slots}")
    browser.wait(f"{SLOT} > 30")
    browser.wait(f"{SLOT} < 30")  # it has begun again
    browser.press("-")
    assert browser.value("[replay.speed, document.querySelector('#speed').value]") == [50, "50"]
    assert browser.errors == []


def test_it_scrubs_by_key_bar_and_chart(still: Replay) -> None:
    browser, slots = still.browser, still.slots
    assert browser.value(f"[replay.playing, {SLOT}]") == [False, 1]  # still, for who wants less motion
    moves = [("ArrowRight", False, 2), ("ArrowRight", True, 12), ("ArrowLeft", False, 11), ("ArrowLeft", True, 1)]
    ends = [("ArrowLeft", False, 1), ("End", False, slots), ("ArrowRight", False, slots), ("Home", False, 1)]
    for key, shift, slot in (*moves, *ends):
        browser.press(key, shift)
        assert browser.value(SLOT) == slot, (key, shift)
    browser.click("#forward")
    assert browser.value(SLOT) == 2
    browser.click("#scrub")
    assert abs(browser.value(SLOT) - (slots + 1) / 2) <= 1
    assert browser.value("document.querySelector('#scrub').getAttribute('aria-valuetext')").startswith("slot ")
    browser.click("#chart", 0.08, 0.5)
    near = browser.value(SLOT)
    assert near < slots / 5
    cursor = browser.value("Number(document.querySelector('#chart .cursor').getAttribute('x1'))")
    assert cursor == pytest.approx(browser.value(f"replay.chart.x({near})"))
    browser.value("location.hash = '#slot=17'")
    browser.wait(f"{SLOT} === 17")


def test_the_table_sorts_and_a_device_is_chosen(still: Replay) -> None:
    browser = still.browser
    browser.value("replay.seek(40)")
    ages = still.missions[0].age_slots[:40].mean(axis=0)  # (I,)
    for falling in (True, False):
        browser.click("#devices th:nth-child(4) button")
        shown = [int(text) for text in browser.texts("#devices td:first-child")]
        np.testing.assert_allclose(ages[shown], np.sort(ages)[:: -1 if falling else 1])
        order = browser.value("document.querySelector('#devices th:nth-child(4)').getAttribute('aria-sort')")
        assert order == ("descending" if falling else "ascending")
    browser.click("#devices tbody tr:first-child td:nth-child(2)")
    assert browser.value("replay.view.chosen") == shown[0]
    assert browser.text("#devices tr.chosen td") == str(shown[0])
    browser.press("Escape")
    assert browser.value("[replay.view.chosen, document.querySelectorAll('tr.chosen').length]") == [-1, 0]
    x, y = browser.value("[replay.maps[1].x(replay.mission.x[2]), replay.maps[1].y(replay.mission.y[2])]")
    width, height = browser.value("replay.maps[1].size")
    browser.click(".flight:nth-child(2) canvas", x / width, y / height)
    assert browser.value("replay.view.chosen") == 2


def test_the_map_draws_what_is_asked_for(still: Replay) -> None:
    """Each layer changes the picture, and so do the slot and the theme; links are there only where data flows."""
    browser = still.browser
    picture = "replay.maps[0].canvas.toDataURL()"
    carried = still.missions[0].recording.communications.any(axis=1)  # (K,)
    busy = int(np.flatnonzero(carried)[5]) + 1
    browser.value(f"replay.seek({busy})")
    before = browser.value(picture)
    for layer in ("coverage", "trails", "links", "numbers"):
        browser.click(f'[data-layer="{layer}"]')
        assert browser.value(picture) != before, layer
        browser.click(f'[data-layer="{layer}"]')
        assert browser.value(picture) == before, layer
    idle = int(np.flatnonzero(~carried)[0]) + 1 if not carried.all() else None
    if idle is not None:
        browser.value(f"replay.seek({idle})")
        quiet = browser.value(picture)
        browser.click('[data-layer="links"]')
        assert browser.value(picture) == quiet
    browser.click("#theme-button")
    assert browser.value("document.documentElement.dataset.theme") == "dark"
    browser.value(f"replay.seek({busy})")
    assert browser.value(picture) != before


@pytest.mark.parametrize(("width", "height", "dark"), [(375, 740, True), (1440, 900, False)], ids=["phone", "desk"])
def test_it_fits_the_screen_and_every_control_has_a_name(replayed: Replay, width: int, height: int, dark: bool) -> None:
    browser = replayed.browser
    browser.open(replayed.page, width, height, dark=dark, still=True, phone=width < 600)
    assert browser.value("document.documentElement.dataset.theme") == ("dark" if dark else "light")
    assert browser.value("[document.documentElement.scrollWidth, innerWidth]") == [width, width]
    assert browser.value("document.querySelector('.player').getBoundingClientRect().bottom") <= height + 0.5
    assert browser.value("document.querySelector('#maps canvas').clientWidth") >= 140
    assert (
        browser.value("(({scrollWidth, clientWidth}) => scrollWidth - clientWidth)(document.querySelector('.scroll'))")
        == 0
    )
    every = "[...document.querySelectorAll('button, select, input')]"
    named = "one.textContent.trim() || one.ariaLabel || one.labels?.length"
    assert browser.value(f"{every}.filter((one) => !({named})).length") == 0
    sizes = browser.value("[...document.querySelectorAll('.player button')].map((one) => one.clientWidth)")
    assert min(sizes) >= 24
    assert browser.errors == []


def test_a_real_field_shows_its_zones_names_and_coordinates(replayed: Replay, tmp_path: Path) -> None:
    names = ["barn", "well", "mast", "pond"]
    scenario = Scenario.load("tiny").replace(
        georeference={"latitude": 46.1, "longitude": 7.22, "bearing_deg": 0},
        no_fly=[{"polygon_m": [[120, 120], [180, 120], [180, 180]], "name": "school"}],
        outline_m=[[0, 0], [200, 0], [200, 200], [0, 200]],
        device_names=names[: Scenario.load("tiny").devices],
        uav_names=["red", "blue"],
    )
    mission = RecordedMission(scenario, "greedy", None, 3, record_mission(scenario, make_planner("greedy"), 3))
    write_replay(tmp_path / "field.html", {"greedy": mission})
    browser = replayed.browser
    take(browser, tmp_path / "field.html", 5, (390, 844, False, True), tmp_path / "field.png")
    assert (tmp_path / "field.png").stat().st_size > 10_000
    assert set(names) >= set(browser.texts("#devices button span:last-child")) >= {"barn"}
    where = browser.value("replay.maps[0].where(replay.maps[0].x(0), replay.maps[0].y(200))")
    x, y, latitude, longitude = map(float, re.findall(r"[\d.]+", where))
    expected = Projection.of(scenario).to_degrees(np.array([0.0, 200.0]))
    assert (round(x), round(y)) == (0, 200)
    assert (latitude, longitude) == pytest.approx(tuple(expected), abs=2e-6)
    assert "slots (" in browser.text(".more")
    assert "red at" in browser.value("replay.maps[0].words(1)")
    assert browser.errors == []


def test_a_mission_with_batteries_losses_links_and_wind_is_shown(replayed: Replay, tmp_path: Path) -> None:
    _, mission, _ = fly(**ITEMS)
    write_replay(tmp_path / "day.html", {"one": mission, "two": mission})
    browser = replayed.browser
    take(browser, tmp_path / "day.html", 12, (390, 844, False, True), tmp_path / "day.png")
    assert browser.value("document.documentElement.scrollWidth") == 390
    unseen = "[...document.querySelectorAll('[data-item]')].filter((one) => one.hidden).length"
    assert browser.value(unseen) == 0
    (swap, u), recording, tau = mission.events["swap"][0], mission.recording, mission.scenario.slot_length_s
    assert recording.battery is not None
    for slot in (12, int(swap)):
        browser.value(f"replay.seek({slot})")
        rows = browser.texts(".fleet li")[: mission.scenario.uavs]
        assert rows[1].endswith("failed at 1:00 min") == (9 <= slot < 20)
        for uav in {0, int(u)}:
            left = int(recording.swap_left[slot - 1, uav])  # type: ignore[index]
            state = f"swap, {round(left * tau)} s left" if left else f"{100 * recording.battery[slot - 1, uav]:.0f} %"
            assert rows[uav].endswith(state) or uav == 1
        late = int(mission.late[slot - 1].sum())  # type: ignore[index]
        assert f"{late} of 8 above the age limit of 60 s" in browser.texts(".fleet .counts")[0]
    picture = "replay.maps[0].canvas.toDataURL()"
    browser.value("replay.seek(8)")  # before the first failure
    before = browser.value(picture)
    browser.click('[data-layer="messages"]')
    assert browser.value(picture) != before
    marks = browser.value("[...document.querySelectorAll('#marks i')].map((one) => one.className)")
    assert {kind: marks.count(kind) for kind in set(marks)} == {k: len(v) for k, v in mission.events.items()}
    assert "UAV 1 is repaired at 2:13 min" in browser.value("document.querySelector('#marks').ariaLabel")
    browser.open(replayed.page, still=True)  # without all of it
    assert browser.value(unseen) == browser.value("document.querySelectorAll('[data-item]').length")
    assert browser.value("[...document.querySelectorAll('.fleet, #marks')].every((one) => one.hidden)")
    assert browser.errors == []


def test_no_policy_has_the_colour_of_a_uav(replayed: Replay) -> None:
    for dark in (False, True):
        replayed.browser.open(replayed.page, still=True, dark=dark)
        script = (
            "[...Array(8).keys()].map((k) => getComputedStyle(document.documentElement).getPropertyValue(`--{}-${k}`))"
        )
        uavs, policies = (set(replayed.browser.value(script.replace("{}", kind))) for kind in ("uav", "policy"))
        assert len(uavs) == 8
        assert len(policies - {""}) == 6
        assert not uavs & policies
