"""What the features of files stand for: devices, stations, an outline, zones. Every guess is noted."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, Feature, Reading, Role, circle, extra, listed
from uavaou.field.locate import NEAR_KM, all_places, in_one_frame, km_between, near_places, on_one_map
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
_WIDEST_KM = 200.0  # beyond, distances on a plane are wrong by more than 0.02 %
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
    called: list[tuple[Feature, str]] = field(default_factory=list)  # stations that only a word made such, and where
    facts: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # all that was ignored or guessed


@lru_cache(maxsize=4096)
def _meanings(names: tuple[str, ...]) -> dict[str, str]:
    return meanings(names)


def meanings_of(feature: Feature) -> dict[str, str]:
    """The property of a feature that stands for each meaning, as far as there is one."""
    return _meanings(tuple(feature.properties))


def value_of(feature: Feature, meaning: str) -> Any:
    """The property of a feature that stands for something; None without one."""
    name = meanings_of(feature).get(meaning)
    return None if name is None else feature.properties[name]


def name_of(feature: Feature) -> str:
    """The name of a feature, else its id, in printable letters; empty without both."""
    for meaning in ("name", "id"):
        value = value_of(feature, meaning)
        text = str(value or "") if isinstance(value, str | int | float) else ""
        text = text.removesuffix(".0") if isinstance(value, float) else text
        if text := " ".join("".join(c if c.isprintable() else " " for c in text).split())[:90]:
            return text
    return ""


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
                raise InputError(
                    f"--station {latitude:g},{longitude:g}: expected a latitude (-90 to 90), then a longitude"
                )
        near = (within[1], within[0]) if within else stations[0] if stations else None
        located = on_one_map(located, near, notes)
    survey = Survey(geographic, notes=notes)
    for reading, features in located:
        for feature in features:
            _sort(survey, reading, feature, several=len(readings) > 1)
        survey.facts.append(f"{reading.path.name}: {_count(features)}")
    if within and geographic:
        _keep_within(survey, within)
    said = [f for f, why in survey.called if not survey.devices or why != _BY_FILE]
    if len(said) > len(survey.devices):
        called = set(map(id, said))
        survey.devices += said
        survey.stations = [feature for feature in survey.stations if id(feature) not in called]
        survey.notes = [note for note in survey.notes if "is a station, by" not in note]
        survey.notes.append(
            f"{len(said)} points are called stations, more than there are devices: they are devices too"
        )
    if stations:
        if survey.stations:
            survey.notes.append(f"{len(survey.stations)} stations of the files are ignored: --station is given")
        survey.stations = [Feature("point", ((place[0], place[1]),), "--station") for place in stations]
    _settle(survey, readings[0].path)
    return survey


def _count(features: Sequence[Feature]) -> str:
    counts = Counter(feature.shape for feature in features)
    return ", ".join(f"{n:,} {shape}{'s' if n != 1 else ''}" for shape, n in counts.items()) or "nothing"


def _keep_within(survey: Survey, within: Sequence[float]) -> None:
    latitude, longitude, km = within
    for kind in ("devices", "stations"):
        features = getattr(survey, kind)
        kept = [f for f in features if km_between(f.places[0], (longitude, latitude)) <= km]
        if len(kept) < len(features):
            survey.notes.append(f"{len(features) - len(kept)} {kind} beyond {km:g} km of --within are ignored")
            setattr(survey, kind, kept)


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
    shapely, places = extra("shapely"), all_places(survey.devices)
    if not called and unsaid:
        shares = [shapely.intersects_xy(_polygon(zone), *places.T).mean() for zone in unsaid]
        best = max(range(len(unsaid)), key=lambda k: (shares[k], _polygon(unsaid[k]).area))
        if shares[best] > 0.5:
            called = [unsaid[best]]
            survey.notes.append(
                f"{called[0].where}: is taken for the outline: it holds {shares[best]:.0%} of the devices"
            )
    survey.outline = max(called, key=lambda zone: float(_polygon(zone).area), default=None)
    if len(called) > 1:
        survey.notes.append(f"of {len(called)} outlines, the largest alone is used ({called[0].where} ...)")
    survey.zones = [zone for zone in survey.zones if zone not in called]
    guessed = [zone.where for zone in survey.zones if not zone.role]
    if guessed:
        survey.notes.append(f"polygons taken for no-fly zones: {listed(guessed, '; ')}")


def _polygon(zone: Feature) -> Any:
    shapely = extra("shapely")
    return shapely.make_valid(shapely.Polygon(zone.places))


def _refuse_too_wide(survey: Survey, path: Path) -> None:
    places = all_places(survey.devices)
    if abs(places[:, 1]).max() > _POLE:
        worst = places[abs(places[:, 1]).argmax(), 1]
        raise InputError(f"{path}: latitude = {worst:.6g}: fields within 2 degrees of a pole are not read")
    middle = np.median(places, axis=0).tolist()
    off = [feature for feature in survey.devices if km_between(feature.places[0], middle) > _WIDEST_KM / 2]
    if 0 < len(off) <= _STRAY * len(survey.devices):
        strays = set(map(id, off))
        survey.devices = [feature for feature in survey.devices if id(feature) not in strays]
        which = listed([feature.where for feature in off])
        survey.notes.append(f"{len(off)} devices far from all others are ignored ({which})")
    kept = [zone for zone in survey.zones if _reach_km(zone, middle) <= _WIDEST_KM]
    if len(kept) < len(survey.zones):
        survey.notes.append(f"{len(survey.zones) - len(kept)} zones that reach beyond {_WIDEST_KM:g} km are ignored")
        survey.zones = kept
    if survey.outline is not None and _reach_km(survey.outline, middle) > _WIDEST_KM:
        raise InputError(f"{survey.outline.where}: an outline that reaches beyond {_WIDEST_KM:g} km")
    far = max(survey.devices + survey.stations, key=lambda f: km_between(f.places[0], middle))
    if (km := km_between(far.places[0], middle)) > _WIDEST_KM / 2:
        tried = places[:: len(places) // 200 + 1]
        count, near = max((int(near_places(places, place).sum()), tuple(place)) for place in tried.tolist())
        raise InputError(
            f"{path}: {far.where.rpartition(', ')[2]} {short(name_of(far))} lies {km:,.0f} km from the middle of the "
            f"{len(places):,} devices; a field is at most {_WIDEST_KM:g} km wide: "
            f"--within {near[1]:.4f},{near[0]:.4f},{NEAR_KM:g} would read {count} of them, all within {NEAR_KM:g} km"
        )


def _reach_km(polygon: Feature, middle: Sequence[float]) -> float:
    return max(km_between(place, middle) for place in polygon.places)


_OF_DEVICES = {"latitude", "longitude", "x", "y", "place", "id", "name", "interval", "role"}
_OF_ZONES = {"id", "name", "role", "radius", "floor", "ceiling", "margin"}


def _note_properties(survey: Survey) -> None:
    """Note what devices and zones say that the model has no place for."""
    for kind, features, read in (("devices", survey.devices, _OF_DEVICES), ("zones", survey.zones, _OF_ZONES)):
        used = {"folder", *DEVICE_COLUMNS}
        used |= {name for f in features for meaning, name in meanings_of(f).items() if meaning in read}
        ignored = [name for name in dict.fromkeys(name for f in features for name in f.properties) if name not in used]
        if ignored:
            survey.notes.append(f"properties of the {kind} that are ignored: {', '.join(map(_plain, ignored))}")
    heights = [number(value_of(f, "height")) for f in survey.devices if value_of(f, "height") is not None]
    heights = [height for height in heights if math.isfinite(height)]
    if heights and max(heights) - min(heights) > 0:
        low, high = min(heights), max(heights)
        survey.notes.append(
            f"heights of the devices, {low:g} to {high:g}, are ignored: the ground is flat in the model"
        )


def _plain(name: str) -> str:
    return short(re.sub(r"\s+", " ", name))[1:-1]
