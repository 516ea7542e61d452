"""The page that replays missions: what stands in it, what it refuses, and the committed ones."""

import base64
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from tests.documents import ROOT
from uavaou import InputError, Scenario
from uavaou.evaluation.recorded_mission import RecordedMission, record_mission
from uavaou.planners import make_planner
from uavaou.reports.replay.film import film_frame, write_film
from uavaou.reports.replay.page import by_label, fill_page, read_content, write_replay

COMMITTED = sorted([*ROOT.glob("docs/gallery/*.html"), *ROOT.glob("results/studies/*/replay.html")])
WEB = ROOT / "uavaou" / "reports" / "replay" / "web"


def fly(planner: str, scenario: str = "tiny", training_seed: int | None = None, seed: int = 5) -> RecordedMission:
    flown = Scenario.load(scenario)
    return RecordedMission(flown, planner, training_seed, seed, record_mission(flown, make_planner(planner), seed))


def unpacked(text: str, *shape: int) -> NDArray[np.int32]:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype="<i4").reshape(shape)


def test_the_page_holds_the_recorded_mission(tmp_path: Path) -> None:
    greedy = fly("greedy", "quickstart")
    write_replay(tmp_path / "x.html", {"greedy": greedy})
    content = read_content(tmp_path / "x.html")
    scenario, recording = greedy.scenario, greedy.recording
    slots, uavs, devices = scenario.slots, scenario.uavs, scenario.devices
    (policy,) = content["policies"]
    cells = unpacked(policy["cells"], slots, uavs, 2)
    np.testing.assert_allclose(cells * content["grid_step_m"], recording.positions)
    carried_by = unpacked(policy["carried_by"], slots, devices)
    np.testing.assert_array_equal(carried_by >= 0, recording.communications)
    np.testing.assert_array_equal(carried_by[carried_by >= 0], recording.collected_by[recording.communications])
    ages = unpacked(policy["age_bends"], slots, devices).cumsum(axis=0).cumsum(axis=0)
    np.testing.assert_allclose(ages * content["slot_length_s"], recording.age_sum)
    assert (content["scenario"], content["mission_seed"], content["slots"]) == ("quickstart", 5, slots)
    places = np.transpose([content["devices"]["x_m"], content["devices"]["y_m"]])
    np.testing.assert_allclose(places, recording.layout.positions, atol=1e-3)


def test_labels_name_the_training_and_are_never_equal() -> None:
    mission = fly("stay")
    runs = [replace(mission, policy="mappo", training_seed=seed) for seed in (3, 3, 4, 3)]
    names = list(by_label([*runs, mission, replace(mission, policy="two $ a day")]))
    assert names == ["MAPPO, seed 3", "MAPPO, seed 3 (2)", "MAPPO, seed 4", "MAPPO, seed 3 (3)", "stay", "two $ a day"]
    study = by_label([replace(mission, policy="published", training_seed=1)], {"published": "mappo"})
    assert list(study) == ["published, seed 1"]


def test_missions_that_are_not_one_are_refused(tmp_path: Path) -> None:
    mission = fly("stay")
    layout = replace(mission.recording.layout, update_period=mission.recording.layout.update_period + 1)
    others = {
        "scenario": replace(mission, scenario=mission.scenario.replace(rate_min_bit_s=1000)),
        "mission_seed": replace(mission, mission_seed=6),
        "update_period of the devices": replace(mission, recording=replace(mission.recording, layout=layout)),
    }
    for what, other in others.items():
        with pytest.raises(InputError, match=f"'one' and 'other' did not fly one mission: they differ in {what}"):
            write_replay(tmp_path / "x.html", {"one": mission, "other": other})
    with pytest.raises(InputError, match="did not fly one mission"):
        list(write_film(tmp_path / "x.gif", {"one": mission, "other": others["mission_seed"]}, "gif"))
    assert list(tmp_path.iterdir()) == []


def test_the_page_asks_for_nothing_and_names_cannot_end_its_script(tmp_path: Path) -> None:
    path = tmp_path / "x.html"
    write_replay(path, {"</script><script>alert(1)</script>": fly("stay")})
    page = path.read_text(encoding="utf-8")
    assert page.count("<script") == page.count("</script>") == 2
    assert "<title>tiny: &lt;/script&gt;" in page
    assert "default-src 'none'" in page
    assert not re.search(r"https?:|\bsrc=|@import|url\((?!#)", page)
    assert read_content(path)["policies"][0]["name"] == "</script><script>alert(1)</script>"


@pytest.mark.parametrize("page", COMMITTED, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_committed_page_is_what_is_written_now(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert fill_page(read_content(page)) == text
    assert len(text.encode()) < 400_000


def test_the_gallery_is_committed_and_another_file_is_no_page(tmp_path: Path) -> None:
    (tmp_path / "x.html").write_text("<p>")
    with pytest.raises(InputError, match=r"x\.html.: holds no mission"):
        read_content(tmp_path / "x.html")
    assert {page.name for page in COMMITTED} >= {"paper.html", "hundred-devices.html", "replay.html"}


def luminance(colour: str) -> float:
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """The contrast ratio of the Web Content Accessibility Guidelines (WCAG)."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_text_and_lines_stand_out(theme: int) -> None:
    block = (WEB / "style.css").read_text(encoding="utf-8").split(":root")[1 + theme].split("}")[0]
    colour = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))
    for ground in ("card", "ground"):
        assert min(contrast(colour[name], colour[ground]) for name in ("ink", "soft")) >= 4.5
    assert min(contrast(colour[f"policy-{k}"], colour["card"]) for k in range(6)) >= 4.5
    assert contrast(colour["on-accent"], colour["accent"]) >= 4.5
    assert contrast(colour["accent"], colour["card"]) >= 3


@pytest.mark.slow
def test_films_have_a_frame_for_each_slot(tmp_path: Path) -> None:
    mission = fly("stay")
    slots = mission.scenario.slots
    frame = film_frame({"greedy": fly("greedy"), "stay": mission}, 4, slots)
    assert frame.shape == (608, 1280, 3)
    assert (frame[:, :640] != frame[:, 640:]).any()
    assert list(write_film(tmp_path / "films" / "x.gif", {"stay": mission}, "gif", 9)) == list(range(1, 10))
    frame = film_frame({"stay": mission}, 4, 9)
    with Image.open(tmp_path / "films" / "x.gif") as gif:
        assert gif.size == (640, 608)
        gif.seek(3)
        shown = np.asarray(gif.convert("RGB"), dtype=np.int16)
    assert np.abs(shown - frame).mean() < 4  # 128 colours
    av = pytest.importorskip("av")
    list(write_film(tmp_path / "x.mp4", {"stay": mission}, "mp4"))
    with av.open(tmp_path / "x.mp4") as film:
        frames = list(film.decode(video=0))
    assert [len(frames), frames[0].width, frames[0].height] == [slots, 640, 608]
