import json
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from uavaou.errors import InputError
from uavaou.family import Family
from uavaou.scenario import Scenario

TINY = Scenario.load("tiny")
SQUARE = [(20.0, 20.0), (60.0, 20.0), (60.0, 60.0), (20.0, 60.0)]
WHOLE = {
    "georeference": {"latitude": 46.1, "longitude": 7.2, "bearing_deg": 30},
    "outline_m": [(0, 0), (200, 0), (200, 200), (0, 200)],
    "no_fly": [{"polygon_m": SQUARE, "floor_m": 0, "ceiling_m": 85, "margin_m": 5, "name": "mast"}],
    "device_names": ["a", "b", 3, "ü"],
    "uav_names": ["red", "blue"],
}


def test_the_fields_are_kept_and_absent_ones_appear_nowhere() -> None:
    scenario = TINY.replace(**WHOLE)
    assert Scenario.from_dict(scenario.to_dict()) == scenario == scenario.replace(layout_seed=TINY.layout_seed)
    assert scenario.device_name(2) == "3"
    assert scenario.uav_name(1) == "blue"
    none = scenario.replace(georeference=None, outline_m=None, no_fly=[], device_names=[], uav_names=())
    assert none.to_yaml() == TINY.to_yaml()
    assert (none.device_name(0), none.uav_name(1)) == ("device 0", "uav_1")
    assert not WHOLE.keys() & TINY.to_dict().keys()


def test_a_file_and_its_table_of_devices_give_them(tmp_path: Path) -> None:
    fields = TINY.to_dict() | {key: WHOLE[key] for key in ("no_fly", "georeference")} | {"devices_csv": "d.csv"}
    del fields["devices"]
    (tmp_path / "field.yaml").write_text(json.dumps(fields))
    (tmp_path / "d.csv").write_text("x_m,Name,y_m\n1,north,2\n3,south,4\n")
    assert Scenario.load(tmp_path / "field.yaml").device_names == ("north", "south")
    (tmp_path / "d.csv").write_text("x_m,name,y_m\n1,,2\n3,south,4\n")
    with pytest.raises(InputError, match="line 2, column 'name' = '': a name needs letters"):
        Scenario.load(tmp_path / "field.yaml")


def test_draws_of_a_family_have_names_of_their_own() -> None:
    family = Family.from_dict({"base": TINY.replace(**WHOLE), "devices": {"low": 2, "high": 9}})
    assert family.draw(3).device_names is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"georeference": {"lat": 3}}, "unknown key 'lat'; did you mean 'latitude'"),
        ({"georeference": {"latitude": 90, "longitude": 0}}, "latitude = 90: must be less than 90"),
        ({"georeference": {"latitude": 0, "longitude": 181}}, "longitude = 181"),
        ({"outline_m": [(0, 0), (1, 1), (0, 0)]}, "at least 3 different points"),
        ({"outline_m": [(0, 0), (1, math.nan), (1, 0)]}, r"outline_m\[1\]\[1\] = nan: must be a finite number"),
        ({"outline_m": [(0, 0), (9, 9), (9, 0), (0, 9)]}, "between points 0 and 1, and between points 2 and 3"),
        ({"no_fly": [{"polygon_m": SQUARE, "floor_m": 9, "ceiling_m": 3}]}, r"floor_m \(9\) must not exceed"),
        ({"no_fly": [{"polygon_m": SQUARE, "margin_m": -1}]}, r"no_fly\[0\].margin_m = -1"),
        ({"no_fly": [{"polygon": SQUARE}]}, "did you mean 'polygon_m'"),
        ({"device_names": ["a"]}, "device_names: has 1 entries, needs one for each of the 4 devices"),
        ({"device_names": ["a", "b", "c", "a "]}, "entries 0 and 3 are both 'a'"),
        ({"uav_names": ["a", "b\n"]}, r"uav_names\[1\]"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        TINY.replace(**changes)
    assert "\n" not in str(error.value)


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=7, unique=True))
def test_polygons_are_refused_where_shapely_finds_them_invalid(points: list[tuple[int, int]]) -> None:
    ring = shapely.LinearRing(points)
    edges = [shapely.LineString(pair) for pair in zip(points, [*points[1:], points[0]], strict=True)]
    proper = all(
        shapely.intersection(a, b).geom_type == "Point" or a.disjoint(b) for a, b in combinations(edges, 2)
    )  # is_simple takes rings that run through a corner twice the same way for closed lines
    try:
        TINY.replace(no_fly=[{"polygon_m": [tuple(map(float, point)) for point in points], "floor_m": 1e3}])
    except InputError:
        assert not (ring.is_simple and shapely.Polygon(points).is_valid)
    else:
        assert ring.is_simple
        assert proper
