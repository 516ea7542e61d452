"""The look of every figure: a dozen variants are told apart, in grey too, by their colours, markers and tags."""

from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from uavaou.reports import style
from uavaou.reports.drawing import AOU, Line, measure_figure
from uavaou.statistics import Band, Interval

TWELVE = {"published": "mappo", **{f"variant {number}": "mappo" for number in range(11)}}


def grey(look: style.Look) -> float:
    """The luma of a colour, 0 to 1."""
    return float(np.dot(to_rgb(look.colour), [0.299, 0.587, 0.114]))


def test_an_algorithm_looks_the_same_in_every_company() -> None:
    alone = style.looks(["mappo"])["mappo"]
    together = style.looks(["vdn", "mappo", "mappo+gamma=0.9", "novel"])
    assert replace(together["mappo"], tag="") == replace(alone, tag="")
    assert together["mappo+gamma=0.9"].label == "MAPPO gamma=0.9"
    assert len({look.colour for look in together.values()}) == 4
    named = style.looks(["mappo", "big", "small vdn"], {"big": "mappo", "mappo": "mappo", "small vdn": "vdn"})
    assert [named[name].label for name in ("mappo", "big", "small vdn")] == ["MAPPO", "big", "small vdn"]
    assert named["mappo"] == alone
    assert named["small vdn"].colour == together["vdn"].colour


def test_forty_variants_differ_and_twelve_are_told_apart() -> None:
    looks = style.looks([*TWELVE, "greedy", "best-first", "bound"], TWELVE)
    variants = [looks[name] for name in TWELVE]
    assert variants[0] == style.looks(["published"], TWELVE)["published"]  # the first keeps the algorithm's look
    for one, other in combinations(looks.values(), 2):
        assert one.marker != other.marker
        assert (one.colour, one.dash) != (other.colour, other.dash)
    assert len({look.colour for look in variants}) == 12
    assert all(abs(grey(one) - grey(other)) > 0.04 for one, other in pairwise(variants))
    many = {f"variant {number}": "mappo" for number in range(40)}
    drawn = [(look.colour, look.marker, str(look.dash)) for look in style.looks(many, many).values()]
    assert len(set(drawn)) == 40


def test_long_names_are_numbers_at_the_lines_and_in_the_legend() -> None:
    short = style.looks(["mappo", "greedy"])
    assert [(look.tag, look.entry) for look in short.values()] == [("MAPPO", "MAPPO"), ("greedy", "greedy")]
    long = style.looks(["observation location", "greedy"], {"observation location": "mappo"})
    assert long["observation location"].entry == "1  observation location"
    assert long["greedy"].entry == "2  greedy"


@pytest.mark.parametrize("levels", [np.geomspace(20, 2000, 12), np.full(12, 500.0), np.full(12, 20.0)])
def test_each_line_has_its_tag_at_its_end(levels: np.ndarray) -> None:
    looks = style.looks([*TWELVE, "bound"], TWELVE)
    lines = {
        name: Line(np.arange(3.0), Band(np.array([3000.0, 900.0, level]), np.full(3, np.nan), np.full(3, np.nan)))
        for name, level in zip(TWELVE, levels, strict=True)
    }
    with style.house_style():
        figure, axes = measure_figure(lines, {"bound": Interval(10.0, np.nan, np.nan)}, looks, AOU, devices=5)
        figure.draw_without_rendering()
    places = {text.get_text(): Text.get_window_extent(text) for text in axes.texts}  # without the line to it
    assert set(places) == {look.tag for look in looks.values()}
    boxes = sorted(places.values(), key=lambda box: box.y0)
    assert all(upper.y0 > lower.y0 + 0.8 * lower.height for lower, upper in pairwise(boxes))
    heights = [places[looks[name].tag].y0 for name in TWELVE]
    assert heights == sorted(heights)  # in the order of the lines' ends
    assert all(axes.bbox.x1 < box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    written = []
    for folder in ("one", "two"):
        with style.house_style():
            figure, axes = style.new_axes(height_in=2.5)
            axes.plot([1, 2, 3], label="$x$")
            axes.legend()
            written.append([path.read_bytes() for path in style.save(figure, tmp_path / folder, "line")])
    assert written[0] == written[1]
    assert not any(b"CreationDate" in content for content in written[0])
