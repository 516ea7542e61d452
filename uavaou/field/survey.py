"""What the features of files stand for: devices, stations, an outline, zones. Every guess is noted."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, Feature, Reading, Role, coordinates, kept, listed, moved
from uavaou.field.locate import fault_of, in_one_frame, km_from, on_one_map, seems_swapped
from uavaou.field.words import meanings, words
from uavaou.fields import short

_ROLES: dict[Role, str] = {  # the first ones go first
    "zone": "zone zones nfz nofly fly forbidden exclusion exclude restricted prohibited obstacle obstacles keepout",
    "outline": "outline boundary boundaries area fence geofence perimeter inclusion border site field",
    "station": "station stations base bases depot depots home cds gcs dock docks hangar launch takeoff",
    "device": "sensor sensors device devices node nodes",
}
_BY_FILE = "file's name"
_HOMES = ({"home"}, {"base"}, {"depot"}, {"cds"}, {"gcs"}, {"base", "station"}, {"ground", "station"})
_WIDEST_KM = 200.0  # beyond, distances on a plane are wrong by more than 0.02 %
_NEAR_DEGREES = 0.09  # some 10 km of latitude
_STRAY = 0.05  # the share of devices that may lie far off by mistake
_POLE = 88.0  # degrees of latitude, beyond which longitudes say little


@dataclass
class Survey:
    """Devices, stations, outline and zones, all in degrees (longitude, latitude), or all in metres."""

    geographic: bool
    devices: list[Feature] = field(default_factory=list)
    stations: list[Feature] = field(default_factory=list)
    outline: Feature | None = None
    zones: list[Feature] = field(default_factory=list)
    facts: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # all that was ignored or guessed


def understand(
    readings: Sequence[Reading], crs: str = "", stations: Sequence[Sequence[float]] = (), within: Sequence[float] = ()
) -> Survey:
    """Decide what the features of some files are.

    Args:
        readings: of the files.
        crs: of coordinates in metres, such as ``EPSG:32632``; ``degrees`` or ``metres`` where columns are just x and y.
        stations: that were given beside the files: latitude and longitude, or x and y in metres.
        within: latitude, longitude and kilometres of a circle outside of which all points are ignored.

    Raises:
        InputError: there is no device, or places cannot be on one map.
    """
    notes = [f"{reading.path.name}: {note}" for reading in readings for note in reading.notes]
    located = {reading: in_one_frame(reading, crs, notes) for reading in readings}
    frames = {feature.frame: reading.path for reading, features in located.items() for feature in features}
    if not frames:
        raise InputError(f"{readings[0].path}: holds no place")
    if len(frames) > 1:
        raise InputError(
            f"{frames[METRES]}: in metres beside files in degrees: --crs EPSG:... says where its origin lies"
        )
    survey = Survey(DEGREES in frames, notes=notes)
    points: list[Feature] = []
    given = [Feature(shapely.Point(place), "--station") for place in stations]
    if survey.geographic:
        given = moved(given, lambda places: places[:, ::-1])
        if fault := fault_of(given):
            raise InputError(f"{fault}, LAT,LON in degrees")
    near = np.array([within[1], within[0]]) if within else coordinates(given)[0] if given else None
    for reading, features in located.items():
        if survey.geographic and features:
            if given and not within and reading.path.suffix.lower() in _TABLES:
                _check_order(reading, features, given[0])
            features = on_one_map(reading, features, near, notes)
            near = np.median(coordinates(features), axis=0) if near is None else near
        counts = Counter(feature.geometry.geom_type.lower() for feature in features)
        counted = [f"{n:,} {shape.replace('string', '')}{'s' if n != 1 else ''}" for shape, n in counts.items()]
        survey.facts.append(f"{reading.path.name}: {', '.join(counted) or 'nothing'}")
        for feature in features:
            feature = _with_role(reading.path, feature, several=len(readings) > 1)
            (points if feature.geometry.geom_type == "Point" else survey.zones).append(feature)
    is_zone = np.array([feature.role == "zone" for feature in points], dtype=np.bool_)
    points = kept(points, ~is_zone, notes, "points that are called zones are ignored: draw polygons")
    is_line = np.array([feature.geometry.geom_type == "LineString" for feature in survey.zones], dtype=np.bool_)
    survey.zones = kept(survey.zones, ~is_line, notes, "lines are ignored")
    if within and survey.geographic and points:
        away = km_from((within[1], within[0]), coordinates(points))
        points = kept(points, away <= within[2], notes, f"points beyond {within[2]:g} km of --within are ignored")
    _settle_stations(survey, points, given)
    _settle(survey, readings[0].path)
    return survey


def _with_role(path: Path, feature: Feature, several: bool) -> Feature:
    """A feature with what it says that it is, and by what; its format comes first, the file's name last."""
    shape = feature.geometry
    is_point = shape.geom_type == "Point"
    texts = {"property": feature.value("role"), "folder": feature.properties.get("folder")}
    if not is_point:
        texts["name"] = feature.name
    if several or not is_point:
        texts[_BY_FILE] = path.stem
    role, by = feature.role, ""
    for by_, text in texts.items() if not role else ():
        said = set(words(str(text or "")))
        allowed: tuple[Role, ...] = ("station", "device", "zone") if is_point else ("zone", "outline")
        role = next((each for each in allowed if said & set(_ROLES[each].split())), "")
        if role:
            by = by_
            break
    if role and shape.geom_type == "LineString" and len(shape.coords) > 2:
        shape = shapely.Polygon(shape)
    return replace(feature, geometry=shape, where=f"{path.name}, {feature.where}", role=role, by=by)


def _settle_stations(survey: Survey, points: Sequence[Feature], given: list[Feature]) -> None:
    """Tell stations from devices; stations that were given replace those of the files."""
    survey.devices = [feature for feature in points if feature.role != "station"]
    stations = [feature for feature in points if feature.role == "station"]
    homes = [feature for feature in survey.devices if set(words(feature.name)) in _HOMES]
    if not (stations or given) and len(homes) == 1:
        stations = [replace(homes[0], by="name")]
        survey.devices.remove(homes[0])
    said = {f for f in stations if f.by and (f.by != _BY_FILE or not survey.devices)}  # a word alone made them such
    if len(said) > len(survey.devices):
        survey.devices += [feature for feature in stations if feature in said]
        stations = [feature for feature in stations if feature not in said]
        survey.notes.append(f"{len(said)} points are called stations, more than there are devices: all are devices")
    survey.notes += [f"{feature.where}: is a station, by its {feature.by}" for feature in stations if feature.by]
    if given and stations:
        survey.notes.append(f"{len(stations)} stations of the files are ignored: --station is given")
    survey.stations = given or stations


def _settle(survey: Survey, path: Path) -> None:
    """Decide what depends on all features together."""
    if not survey.devices:
        raise InputError(f"no places of devices ({'; '.join(survey.facts)}): add a file with points for them")
    places = coordinates(survey.devices).round(6).tolist()
    keys = pd.Series([(f.name or k, *place) for k, (f, place) in enumerate(zip(survey.devices, places, strict=True))])
    repeat = "rows repeat a device (the same name and place), and are ignored"  # as in a table of measurements
    survey.devices = kept(survey.devices, ~keys.duplicated().to_numpy(), survey.notes, repeat)
    if survey.geographic:
        _refuse_too_wide(survey, path)
    _choose_outline(survey)
    _note_properties(survey)


def _choose_outline(survey: Survey) -> None:
    """The polygon that is called an outline, or that holds most of the devices; all others are zones."""
    called = [zone for zone in survey.zones if zone.role == "outline"]
    unsaid = [zone for zone in survey.zones if not zone.role]
    if not called and unsaid:
        places = coordinates(survey.devices)
        shares = [shapely.intersects_xy(shapely.make_valid(zone.geometry), *places.T).mean() for zone in unsaid]
        best = max(range(len(unsaid)), key=lambda k: (shares[k], _area(unsaid[k])))
        if shares[best] > 0.5:
            called = [unsaid[best]]
            survey.notes.append(
                f"{called[0].where}: is taken for the outline: it holds {shares[best]:.0%} of the devices"
            )
    survey.outline = max(called, key=_area, default=None)
    if len(called) > 1:
        survey.notes.append(f"of {len(called)} outlines, the largest alone is used ({called[0].where} ...)")
    survey.zones = [zone for zone in survey.zones if zone not in called]
    if guessed := [zone.where for zone in survey.zones if not zone.role]:
        survey.notes.append(f"polygons taken for no-fly zones: {listed(guessed)}")


def _area(zone: Feature) -> float:
    return float(shapely.make_valid(zone.geometry).area)


def _refuse_too_wide(survey: Survey, path: Path) -> None:
    places = coordinates(survey.devices)
    worst = places[abs(places[:, 1]).argmax(), 1]
    if abs(worst) > _POLE:
        raise InputError(f"{path}: latitude = {worst:.6g}: fields within 2 degrees of a pole are not read")
    middle = np.median(places, axis=0)
    near = km_from(middle, places) <= _WIDEST_KM / 2
    if near.mean() >= 1 - _STRAY:
        survey.devices = kept(survey.devices, near, survey.notes, "devices far from all others are ignored")
    reach = np.array([km_from(middle, coordinates([zone])).max() for zone in survey.zones])
    text = f"polygons that reach beyond {_WIDEST_KM:g} km are ignored"
    survey.zones = kept(survey.zones, reach <= _WIDEST_KM, survey.notes, text)
    points = survey.devices + survey.stations
    away = km_from(middle, coordinates(points))
    far, km = points[away.argmax()], away.max()
    if km > _WIDEST_KM / 2:
        narrow = [math.cos(math.radians(middle[1])), 1.0]
        tried = places[:: len(places) // 200 + 1]
        counts = [(np.linalg.norm((places - each) * narrow, axis=1) < _NEAR_DEGREES).sum() for each in tried]
        x, y = tried[np.argmax(counts)]
        longitude, latitude = coordinates([far])[0]
        named = short(far.name) if far.name else f"{latitude:.4f},{longitude:.4f}"
        raise InputError(
            f"{path}: {far.where.rpartition(', ')[2]} {named} lies {km:,.0f} km from the middle of the "
            f"{len(places):,} devices; a field is at most {_WIDEST_KM:g} km wide: --within {y:.4f},{x:.4f},10 "
            f"would read {max(counts)} of them, all within 10 km"
        )


_TABLES = (".csv", ".tsv", ".txt", ".xlsx")  # whose columns say which is the latitude


def _check_order(reading: Reading, features: list[Feature], station: Feature) -> None:
    """Refuse a station whose latitude and longitude seem swapped: the columns of a table are named."""
    place, middle = coordinates([station])[0], np.median(coordinates(features), axis=0)  # longitude, latitude
    if seems_swapped(place, middle):
        apart, swapped = km_from(place, middle)[0], km_from(place[::-1], middle)[0]
        given, fits = (f"{latitude:.9g},{longitude:.9g}" for longitude, latitude in (place, place[::-1]))
        raise InputError(
            f"--station {given}: lies {apart:,.0f} km from the places of {reading.path.name}, and one of the two has "
            f"latitude and longitude swapped: {fits} would lie {swapped:,.0f} km from them; or correct the columns"
        )


_OF_DEVICES = {"latitude", "longitude", "x", "y", "place", "id", "name", "interval", "role"}
_OF_ZONES = {"id", "name", "role", "floor", "ceiling", "margin"}


def _note_properties(survey: Survey) -> None:
    """Note what devices and zones say that the model has no place for."""
    for kind, features, read in (("devices", survey.devices, _OF_DEVICES), ("zones", survey.zones, _OF_ZONES)):
        keys = dict.fromkeys(tuple(feature.properties) for feature in features)
        used = {"folder"} | {name for names in keys for meaning, name in meanings(names).items() if meaning in read}
        ignored = dict.fromkeys(name for names in keys for name in names if name not in used)
        if ignored:
            plain = ", ".join(short(re.sub(r"\s+", " ", name))[1:-1] for name in ignored)
            survey.notes.append(f"properties of the {kind} that are ignored: {plain}")
