"""What the features of files stand for: devices, stations, an outline, zones. Every guess is noted."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, UNSTATED, Feature, Position, Reading, Role, circle
from uavaou.field.words import meanings, number, words
from uavaou.fields import DEVICE_COLUMNS, short

_ROLES: dict[Role, str] = {
    "zone": "zone zones nfz nofly fly forbidden exclusion exclude restricted prohibited obstacle obstacles keepout",
    "outline": "outline boundary boundaries area fence geofence perimeter inclusion border site field",
    "station": "station stations base bases depot depots home cds gcs dock docks hangar launch takeoff",
    "device": "sensor sensors device devices node nodes",
}
_BY_FILE = "file's name"
_HOMES = ({"home"}, {"base"}, {"depot"}, {"cds"}, {"gcs"}, {"base", "station"}, {"ground", "station"}, {"take", "off"})
_KM = 111.195  # of a degree of latitude
_LEAST_M = 20.0  # across a field in metres
_WIDEST_KM = 200.0  # beyond, distances on a plane are wrong by more than 0.02 %
_STRAY = 0.05  # the share of devices that may lie far off by mistake
_NEAR_KM = 10.0
_POLE = 88.0  # degrees of latitude, beyond which longitudes say little
_LISTED = 6


@dataclass
class Survey:
    """Devices, stations, outline and zones, all in degrees (longitude, latitude), or all in metres."""

    geographic: bool
    devices: list[Feature] = field(default_factory=list)
    stations: list[Feature] = field(default_factory=list)
    outline: Feature | None = None
    zones: list[Feature] = field(default_factory=list)
    called: list[tuple[Feature, str]] = field(default_factory=list)  # stations that only a word made such, and where
    facts: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # all that was ignored or guessed


@lru_cache(maxsize=4096)
def _meanings(names: tuple[str, ...]) -> dict[str, str]:
    return meanings(names)


def value_of(feature: Feature, meaning: str) -> Any:
    """The property of a feature that stands for something; None without one."""
    name = _meanings(tuple(feature.properties)).get(meaning)
    return None if name is None else feature.properties[name]


def name_of(feature: Feature) -> str:
    """The name of a feature, else its id, in printable letters; empty without both."""
    for meaning in ("name", "id"):
        value = value_of(feature, meaning)
        text = str(int(value)) if isinstance(value, float) and value.is_integer() else str(value or "")
        if text := " ".join("".join(c if c.isprintable() else " " for c in text).split())[:90]:
            return text
    return ""


def understand(readings: Sequence[Reading], crs: str = "", stations: Sequence[Position] = (), within: Sequence[float] = ()) -> Survey:
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
    located = [(reading, _in_frame(reading, crs, notes)) for reading in readings]
    frames = {feature.frame for _, features in located for feature in features}
    if len(frames) > 1:
        in_metres = next(r.path for r, features in located if any(f.frame == METRES for f in features))
        raise InputError(f"{in_metres}: in metres beside files in degrees: --crs EPSG:... says where its origin lies")
    geographic = frames == {DEGREES}
    if not frames:
        raise InputError(f"{readings[0].path}: holds no place")
    if geographic:
        stations = [(longitude, latitude) for latitude, longitude in stations]
        for longitude, latitude in stations:
            if abs(latitude) > 90 or abs(longitude) > 180:
                raise InputError(f"--station {latitude:g},{longitude:g}: a latitude from -90 to 90, then a longitude from -180 to 180")
        near = (within[1], within[0]) if within else stations[0] if stations else None
        located = _on_one_map(located, near, notes)
    survey = Survey(geographic, notes=notes)
    for reading, features in located:
        for feature in features:
            _sort(survey, reading, feature, several=len(readings) > 1)
        survey.facts.append(f"{reading.path.name}: {_count(features)}")
    if within and geographic:
        _keep_within(survey, within)
    said = [f for f, why in survey.called if not survey.devices or why != _BY_FILE]
    if len(said) > len(survey.devices):
        survey.devices += said
        survey.stations = [feature for feature in survey.stations if feature not in said]
        survey.notes = [note for note in survey.notes if "is a station, by" not in note]
        survey.notes.append(f"{len(said)} points are called stations, more than there are devices: they are devices too")
    if stations:
        if survey.stations:
            survey.notes.append(f"{len(survey.stations)} stations of the files are ignored: --station is given")
        survey.stations = [Feature("point", (tuple(place),), "--station") for place in stations]
    _settle(survey, readings[0].path)
    return survey


def _count(features: Sequence[Feature]) -> str:
    counts = Counter(feature.shape for feature in features)
    return ", ".join(f"{n:,} {shape}{'s' if n != 1 else ''}" for shape, n in counts.items()) or "nothing"


# -- frames -----------------------------------------------------------------------------------------------------------


def _in_frame(reading: Reading, crs: str, notes: list[str]) -> list[Feature]:
    """The features in degrees, or in metres without an origin."""
    frames = {feature.frame for feature in reading.features}
    meant = {frame: crs or frame if frame in (METRES, UNSTATED) else frame for frame in frames}
    if meant.get(UNSTATED) == UNSTATED:
        meant[UNSTATED] = _guessed_frame(reading, notes)
    found = []
    for frame in frames:
        features = [feature for feature in reading.features if feature.frame == frame]
        if meant[frame] not in (DEGREES, METRES):
            features = _from_crs(reading, features, meant[frame])
            meant[frame] = DEGREES
        elif meant[frame] == METRES:
            _refuse_degrees(reading, features)
        found += [replace(feature, frame=meant[frame]) for feature in features]
    if crs and not frames & {METRES, UNSTATED}:
        notes.append(f"{reading.path.name}: --crs {crs} is ignored: it holds degrees")
    return found


def _all_places(features: Iterable[Feature]) -> Floats:
    return np.array([place for feature in features for place in feature.places], dtype=np.float64).reshape(-1, 2)


def _guessed_frame(reading: Reading, notes: list[str]) -> str:
    """Whether columns that are just x and y hold degrees: small, close to each other, and with many decimals.

    Raises:
        InputError: they could be both.
    """
    places = _all_places(feature for feature in reading.features if feature.frame == UNSTATED)
    narrow = float(np.ptp(places, axis=0).max(initial=0)) < _LEAST_M
    small = narrow and (abs(places) <= 180).all()
    precise = (abs(places * 100 - np.rint(places * 100)) > 1e-6).mean() > 0.5
    if small and len(places) > 1 and (reading.headless or not precise or (abs(places[:, 1]) > 90).any()):
        raise InputError(f"{reading.path}: x and y could be metres or degrees: write a header of x_m, y_m or of lat, lon")
    frame = DEGREES if small and precise and not reading.headless else METRES
    notes.append(f"{reading.path.name}: x and y are taken for {'longitude and latitude' if frame == DEGREES else 'metres'}")
    if frame == METRES and (abs(places) > 90_000).all():
        notes.append(f"{reading.path.name}: they look like UTM: --crs EPSG:326.. or 327.. would keep coordinates")
    return frame


def _refuse_degrees(reading: Reading, features: Sequence[Feature]) -> None:
    places = _all_places(features)
    if len(places) > 1 and (abs(places) <= [180, 90]).all() and 0 < np.ptp(places, axis=0).max() < 0.5:
        raise reading.error(
            features[0].where, f"{places[0].tolist()} is said to be metres and looks like degrees: give --crs degrees"
        )


def _from_crs(reading: Reading, features: list[Feature], crs: str) -> list[Feature]:
    """The features in degrees."""
    try:
        from pyproj import Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        raise InputError("coordinates need pyproj: pip install 'uavaou[field]'") from None
    try:
        transformer = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except ProjError:
        raise InputError(f"--crs {short(crs)}: no coordinate reference system; expected one such as EPSG:32632") from None
    places = _all_places(features)
    degrees = np.stack(transformer.transform(*places.T), axis=-1)  # (P, 2)
    wrong = np.flatnonzero(~np.isfinite(degrees).all(axis=1))
    counts = np.cumsum([len(feature.places) for feature in features])
    if len(wrong):
        where = features[int(np.searchsorted(counts, wrong[0], side="right"))].where
        raise reading.error(where, f"{places[wrong[0]].tolist()} lies outside of {crs}")
    parts = np.split(degrees, counts[:-1])
    return [replace(f, places=tuple(map(tuple, part.tolist()))) for f, part in zip(features, parts, strict=True)]


# -- degrees ----------------------------------------------------------------------------------------------------------


def _on_one_map(
    located: Sequence[tuple[Reading, list[Feature]]], near: Position | None, notes: list[str]
) -> list[tuple[Reading, list[Feature]]]:
    """Features with latitudes and longitudes in order, and longitudes that do not jump."""
    found = []
    for reading, features in located:
        features = _without_null_island(reading, features, notes)
        places = _all_places(features)
        if len(places):
            straight, swapped = _fault(features), _fault([_swapped(feature) for feature in features])
            middle = tuple(np.median(places, axis=0).tolist())
            far = near is not None and _km(middle, near) > 500 and _km(middle[::-1], near) < 100
            if (straight or far) and not swapped:
                features = [_swapped(feature) for feature in features]
                why = straight or "as given, they lie far from the others"
                notes.append(f"{reading.path.name}: latitude and longitude are swapped back ({why})")
            elif straight:
                raise InputError(f"{reading.path}: {straight}")
            near = near or tuple(np.median(_all_places(features), axis=0).tolist())
        found.append((reading, features))
    if near is None:
        return found
    turned = near[0]
    return [(r, [_near_longitude(feature, turned) for feature in features]) for r, features in found]


def _without_null_island(reading: Reading, features: list[Feature], notes: list[str]) -> list[Feature]:
    kept = [f for f in features if any(map(any, f.places))]
    if kept and len(kept) < len(features) and abs(_all_places(kept)).max() > 1:
        notes.append(f"{reading.path.name}: {len(features) - len(kept)} places at 0, 0 are ignored")
        return kept
    return features


def _swapped(feature: Feature) -> Feature:
    return replace(feature, places=tuple((y, x) for x, y in feature.places))


def _fault(features: Sequence[Feature]) -> str:
    """What is wrong with the first place that is none on the earth; empty without one."""
    for feature in features:
        for longitude, latitude in feature.places:
            if abs(latitude) > 90:
                return f"{feature.where}: latitude = {latitude:.9g}: must be from -90 to 90"
            if abs(longitude) > 360:
                return f"{feature.where}: longitude = {longitude:.9g}: must be from -180 to 180"
    return ""


def _near_longitude(feature: Feature, longitude: float) -> Feature:
    """With longitudes within half a turn of another one, across the antimeridian."""
    return replace(feature, places=tuple(((x - longitude + 180) % 360 - 180 + longitude, y) for x, y in feature.places))


def _km(first: Sequence[float], second: Sequence[float]) -> float:
    """The distance of two places, on a sphere."""
    (x, y), (u, v) = (map(math.radians, place) for place in (first, second))
    haversine = math.sin((y - v) / 2) ** 2 + math.cos(y) * math.cos(v) * math.sin((x - u) / 2) ** 2
    return 2 * math.degrees(math.asin(min(math.sqrt(max(haversine, 0.0)), 1.0))) * _KM


def _keep_within(survey: Survey, within: Sequence[float]) -> None:
    latitude, longitude, km = within
    for kind in ("devices", "stations"):
        features = getattr(survey, kind)
        kept = [f for f in features if _km(f.places[0], (longitude, latitude)) <= km]
        if len(kept) < len(features):
            survey.notes.append(f"{len(features) - len(kept)} {kind} beyond {km:g} km of --within are ignored")
            setattr(survey, kind, kept)


# -- roles ------------------------------------------------------------------------------------------------------------


def _sort(survey: Survey, reading: Reading, feature: Feature, several: bool) -> None:
    """Put a feature to the devices, stations or zones; an outline to the zones with its role, until all are known."""
    role, why = _role(reading.path, feature, several)
    where = f"{reading.path.name}, {feature.where}"
    if role == "zone" and feature.shape == "point":
        radius = number(value_of(feature, "radius") or "")
        if survey.geographic and radius > 0:
            feature = replace(feature, shape="polygon", places=circle(feature.places[0], radius))
        else:
            survey.notes.append(f"{where}: a point that is called a zone, without a radius, is ignored")
            return
    if feature.shape == "line" and role in ("zone", "outline") and len(set(feature.places)) >= 3:
        feature = replace(feature, shape="polygon")
    feature = replace(feature, where=where, role=role)
    if feature.shape == "polygon":
        survey.zones.append(feature)
    elif feature.shape == "point":
        (survey.stations if role == "station" else survey.devices).append(feature)
        if role == "station" and why:
            survey.called.append((feature, why))
            survey.notes.append(f"{where}: is a station, by its {why}")
    else:
        survey.notes.append(f"{where}: a line is ignored")


def _role(path: Path, feature: Feature, several: bool) -> tuple[Role, str]:
    """What a feature says that it is, and by what; its format comes first, the file's name last."""
    if feature.role:
        return feature.role, ""
    allowed: tuple[Role, ...] = ("zone", "outline") if feature.shape != "point" else ("station", "device", "zone")
    name = words(name_of(feature))
    texts = [("property", str(value_of(feature, "role") or "")), ("folder", str(feature.properties.get("folder", "")))]
    texts += [("name", " ".join(name))] if feature.shape != "point" else []
    texts += [(_BY_FILE, path.stem)] if several or feature.shape != "point" else []
    for why, text in texts:
        said = set(words(text))
        for role in allowed:
            if said & set(_ROLES[role].split()):
                return role, why
    return "", ""


def _settle(survey: Survey, path: Path) -> None:
    """Decide what depends on all features together."""
    homes = [f for f in survey.devices if set(words(name_of(f))) in _HOMES]
    if not survey.stations and len(homes) == 1 < len(survey.devices):
        survey.stations = homes
        survey.devices.remove(homes[0])
        survey.notes.append(f"{homes[0].where}: is a station, by its name")
    _drop_repeated(survey)
    if not survey.devices:
        raise InputError(f"no places of devices ({'; '.join(survey.facts)}): add a file with points for them")
    _choose_outline(survey)
    if survey.geographic:
        _refuse_too_wide(survey, path)
    _note_properties(survey)


def _drop_repeated(survey: Survey) -> None:
    """Rows that repeat a device: the same name at the same place, as in a table of measurements."""
    kept: dict[Any, Feature] = {}
    for number_, feature in enumerate(survey.devices):
        name = name_of(feature)
        kept.setdefault((name, *(round(x, 6) for x in feature.places[0])) if name else number_, feature)
    if repeated := len(survey.devices) - len(kept):
        survey.notes.append(f"{repeated:,} rows repeat a device (the same name and place), and are ignored")
        survey.devices = list(kept.values())


def _choose_outline(survey: Survey) -> None:
    """The polygon that is called an outline, or that holds most of the devices; all others are zones."""
    if not survey.zones:
        return
    called = [zone for zone in survey.zones if zone.role == "outline"]
    unsaid = [zone for zone in survey.zones if not zone.role]
    places = _all_places(survey.devices)
    if not called and unsaid:
        shares = [_inside(zone, places).mean() for zone in unsaid]
        best = max(range(len(unsaid)), key=lambda k: (shares[k], _size(unsaid[k])))
        if shares[best] > 0.5:
            called = [unsaid[best]]
            survey.notes.append(f"{called[0].where}: is taken for the outline: it holds {shares[best]:.0%} of the devices")
    survey.outline = max(called, key=_size, default=None)
    if len(called) > 1:
        survey.notes.append(f"of {len(called)} outlines, the largest alone is used ({called[0].where} ...)")
    survey.zones = [zone for zone in survey.zones if zone not in called]
    guessed = [zone.where for zone in survey.zones if not zone.role]
    if guessed:
        more = ", ..." if len(guessed) > _LISTED else ""
        survey.notes.append(f"polygons taken for no-fly zones: {'; '.join(guessed[:_LISTED])}{more}")


def _inside(polygon: Feature, places: Floats) -> Bools:
    """Whether places lie in a polygon, (P,): by the edges that a ray to the east crosses."""
    start = np.array(polygon.places)
    end = np.roll(start, -1, axis=0)
    x, y = places.T[:, :, None]  # (P, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start[:, 0] + (y - start[:, 1]) / (end[:, 1] - start[:, 1]) * (end[:, 0] - start[:, 0])
    crossed = ((start[:, 1] > y) != (end[:, 1] > y)) & (x < at)
    return np.asarray(crossed.sum(axis=1) % 2 == 1)


def _size(polygon: Feature) -> float:
    x, y = np.array(polygon.places).T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _refuse_too_wide(survey: Survey, path: Path) -> None:
    places = _all_places(survey.devices)
    if abs(places[:, 1]).max() > _POLE:
        raise InputError(f"{path}: latitude = {places[abs(places[:, 1]).argmax(), 1]:.6g}: fields within 2 degrees of a pole are not read")
    middle = np.median(places, axis=0)
    off = [feature for feature in survey.devices if _km(feature.places[0], middle) > _WIDEST_KM / 2]
    if 0 < len(off) <= _STRAY * len(survey.devices):
        survey.devices = [feature for feature in survey.devices if feature not in off]
        which = ", ".join(feature.where for feature in off[:_LISTED])
        survey.notes.append(f"{len(off)} devices far from all others are ignored ({which}{', ...' if len(off) > _LISTED else ''})")
    far = max(survey.devices + survey.stations, key=lambda f: _km(f.places[0], middle))
    if (km := _km(far.places[0], middle)) > _WIDEST_KM / 2:
        tried = places[:: len(places) // 200 + 1]
        count, near = max((int(_near(places, place).sum()), tuple(place)) for place in tried.tolist())
        raise InputError(
            f"{path}: {far.where.rpartition(', ')[2]} {short(name_of(far))} lies {km:,.0f} km from the middle of the "
            f"{len(places):,} devices; a field is at most {_WIDEST_KM:g} km wide: "
            f"--within {near[1]:.4f},{near[0]:.4f},{_NEAR_KM:g} would read {count} of them, all within {_NEAR_KM:g} km"
        )


def _near(places: Floats, place: Sequence[float]) -> Bools:
    """Which places lie close to one, (P,)."""
    east, north = ((places - place) * [math.cos(math.radians(place[1])) * _KM, _KM]).T
    return np.asarray(np.hypot(east, north) <= _NEAR_KM)


def _note_properties(survey: Survey) -> None:
    """Note what the devices say that the model has no place for."""
    read = {"latitude", "longitude", "x", "y", "place", "id", "name", "interval", "role"}
    names = dict.fromkeys(name for feature in survey.devices for name in feature.properties)
    used = {feature_name for f in survey.devices for meaning, feature_name in _meanings(tuple(f.properties)).items() if meaning in read}
    ignored = [name for name in names if name not in used and name not in DEVICE_COLUMNS and name != "folder"]
    if ignored:
        more = f" and {len(ignored) - 12} more" if len(ignored) > 12 else ""
        survey.notes.append(f"properties of the devices that are ignored: {', '.join(map(_plain, ignored[:12]))}{more}")
    heights = [number(value_of(f, "height")) for f in survey.devices if value_of(f, "height") is not None]
    heights = [height for height in heights if math.isfinite(height)]
    if heights and max(heights) - min(heights) > 0:
        low, high = min(heights), max(heights)
        survey.notes.append(f"heights of the devices, {low:g} to {high:g}, are ignored: the ground is flat in the model")


def _plain(name: str) -> str:
    return short(re.sub(r"\s+", " ", name))[1:-1]
