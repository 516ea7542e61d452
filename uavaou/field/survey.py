"""What the features of files stand for: devices, stations, an outline, zones. Every guess is noted."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, Feature, Reading, Role, coordinates, listed
from uavaou.field.locate import in_one_frame, km_from, on_one_map
from uavaou.field.words import meanings, words
from uavaou.fields import short

_ROLES: dict[Role, str] = {  # the first ones go first
    "zone": "zone zones nfz nofly fly forbidden exclusion exclude restricted prohibited obstacle obstacles keepout",
    "outline": "outline boundary boundaries area fence geofence perimeter inclusion border site field",
    "station": "station stations base bases depot depots home cds gcs dock docks hangar launch takeoff",
    "device": "sensor sensors device devices node nodes",
}
_BY_FILE = "file's name"
_HOMES = ({"home"}, {"base"}, {"depot"}, {"cds"}, {"gcs"}, {"base", "station"}, {"ground", "station"}, {"take", "off"})
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
    located = [(reading, in_one_frame(reading, crs, notes)) for reading in readings]
    frames = {feature.frame for _, features in located for feature in features}
    if not frames:
        raise InputError(f"{readings[0].path}: holds no place")
    if len(frames) > 1:
        in_metres = next(r.path for r, features in located if any(f.frame == METRES for f in features))
        raise InputError(f"{in_metres}: in metres beside files in degrees: --crs EPSG:... says where its origin lies")
    survey = Survey(frames == {DEGREES}, notes=notes)
    if survey.geographic:
        for latitude, longitude in stations:
            if abs(latitude) > 90 or abs(longitude) > 180:
                raise InputError(
                    f"--station {latitude:g},{longitude:g}: expected a latitude (-90 to 90), then a longitude"
                )
        stations = [(longitude, latitude) for latitude, longitude in stations]
        ordered = []
        near = within[1] if within else stations[0][0] if stations else None
        for reading, features in located:
            if features:
                features = on_one_map(reading, features, near, notes)
                near = coordinates(features)[0, 0] if near is None else near
            ordered.append((reading, features))
        located = ordered
    called: dict[Feature, str] = {}
    for reading, features in located:
        for feature in features:
            _sort(survey, reading, feature, called, several=len(readings) > 1)
        counts = Counter(feature.geometry.geom_type.lower() for feature in features)
        counted = [f"{n:,} {shape.replace('string', '')}{'s' if n != 1 else ''}" for shape, n in counts.items()]
        survey.facts.append(f"{reading.path.name}: {', '.join(counted) or 'nothing'}")
    if within and survey.geographic:
        _keep_within(survey, within)
    _settle_stations(survey, stations, called)
    _settle(survey, readings[0].path)
    return survey


def _keep_within(survey: Survey, within: Sequence[float]) -> None:
    latitude, longitude, km = within
    for kind in ("devices", "stations"):
        features = getattr(survey, kind)
        kept = [
            f
            for f, away in zip(features, km_from((longitude, latitude), coordinates(features)), strict=True)
            if away <= km
        ]
        if len(kept) < len(features):
            survey.notes.append(f"{len(features) - len(kept)} {kind} beyond {km:g} km of --within are ignored")
            setattr(survey, kind, kept)


def _sort(survey: Survey, reading: Reading, feature: Feature, called: dict[Feature, str], several: bool) -> None:
    """Put a feature to the devices, stations or zones; an outline to the zones with its role, until all are known."""
    shape = feature.geometry
    role, why = _role(reading.path, feature, shape.geom_type == "Point", several)
    where = f"{reading.path.name}, {feature.where}"
    if role in ("zone", "outline") and len(shape.coords if shape.geom_type == "LineString" else ()) > 2:
        shape = shapely.Polygon(shape)
    feature = replace(feature, geometry=shape, where=where, role=role)
    if shape.geom_type == "LineString" or (role == "zone" and shape.geom_type == "Point"):
        survey.notes.append(
            f"{where}: a zone needs a polygon, ignored" if role == "zone" else f"{where}: a line is ignored"
        )
    elif shape.geom_type == "Polygon":
        survey.zones.append(feature)
    elif role == "station":
        survey.stations.append(feature)
        called |= {feature: why} if why else {}
    else:
        survey.devices.append(feature)


def _role(path: Path, feature: Feature, is_point: bool, several: bool) -> tuple[Role, str]:
    """What a feature says that it is, and by what; its format comes first, the file's name last."""
    texts = {"property": feature.value("role"), "folder": feature.properties.get("folder")}
    if not is_point:
        texts["name"] = feature.name
    if several or not is_point:
        texts[_BY_FILE] = path.stem
    for why, text in texts.items() if not feature.role else ():
        said = set(words(str(text or "")))
        for role in ("station", "device", "zone") if is_point else ("zone", "outline"):
            if said & set(_ROLES[role].split()):
                return role, why
    return feature.role, ""


def _settle_stations(survey: Survey, given: Sequence[Sequence[float]], called: dict[Feature, str]) -> None:
    """Decide whether those that only a word made stations are such; stations that were given replace all."""
    said = {feature for feature, why in called.items() if why != _BY_FILE or not survey.devices}
    if len(said) > len(survey.devices):
        survey.devices += [feature for feature in survey.stations if feature in said]
        survey.stations = [feature for feature in survey.stations if feature not in said]
        survey.notes.append(
            f"{len(said)} points are called stations, more than there are devices: they are devices too"
        )
    else:
        survey.notes += [f"{feature.where}: is a station, by its {why}" for feature, why in called.items()]
    if given:
        if survey.stations:
            survey.notes.append(f"{len(survey.stations)} stations of the files are ignored: --station is given")
        survey.stations = [Feature(shapely.Point(place), "--station") for place in given]
    homes = [feature for feature in survey.devices if set(words(feature.name)) in _HOMES]
    if not survey.stations and len(homes) == 1 < len(survey.devices):
        survey.stations = homes
        survey.devices.remove(homes[0])
        survey.notes.append(f"{homes[0].where}: is a station, by its name")


def _settle(survey: Survey, path: Path) -> None:
    """Decide what depends on all features together."""
    kept: dict[Any, Feature] = {}  # without rows that repeat a device, as in a table of measurements
    for feature, place in zip(survey.devices, coordinates(survey.devices).round(6).tolist(), strict=True):
        kept.setdefault((name, *place) if (name := feature.name) else feature, feature)
    if repeated := len(survey.devices) - len(kept):
        survey.notes.append(f"{repeated:,} rows repeat a device (the same name and place), and are ignored")
        survey.devices = list(kept.values())
    if not survey.devices:
        raise InputError(f"no places of devices ({'; '.join(survey.facts)}): add a file with points for them")
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
        survey.notes.append(f"polygons taken for no-fly zones: {listed(guessed, '; ')}")


def _area(zone: Feature) -> float:
    return float(shapely.make_valid(zone.geometry).area)


def _refuse_too_wide(survey: Survey, path: Path) -> None:
    places = coordinates(survey.devices)
    worst = places[abs(places[:, 1]).argmax(), 1]
    if abs(worst) > _POLE:
        raise InputError(f"{path}: latitude = {worst:.6g}: fields within 2 degrees of a pole are not read")
    middle = np.median(places, axis=0)
    off = {survey.devices[k]: None for k in np.flatnonzero(km_from(middle, places) > _WIDEST_KM / 2)}
    if 0 < len(off) <= _STRAY * len(survey.devices):
        survey.devices = [feature for feature in survey.devices if feature not in off]
        which = listed([feature.where for feature in off])
        survey.notes.append(f"{len(off)} devices far from all others are ignored ({which})")
    kept = [zone for zone in survey.zones if km_from(middle, coordinates([zone])).max() <= _WIDEST_KM]
    if len(kept) < len(survey.zones):
        survey.notes.append(f"{len(survey.zones) - len(kept)} polygons that reach beyond {_WIDEST_KM:g} km are ignored")
        survey.zones = kept
    points = survey.devices + survey.stations
    away = km_from(middle, coordinates(points))
    far, km = points[away.argmax()], away.max()
    if km > _WIDEST_KM / 2:
        narrow = [math.cos(math.radians(middle[1])), 1.0]
        tried = places[:: len(places) // 200 + 1]
        counts = [(np.linalg.norm((places - each) * narrow, axis=1) < _NEAR_DEGREES).sum() for each in tried]
        x, y = tried[np.argmax(counts)]
        raise InputError(
            f"{path}: {far.where.rpartition(', ')[2]} {short(far.name)} lies {km:,.0f} km from the middle of the "
            f"{len(places):,} devices; a field is at most {_WIDEST_KM:g} km wide: --within {y:.4f},{x:.4f},10 "
            f"would read {max(counts)} of them, all within 10 km"
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
