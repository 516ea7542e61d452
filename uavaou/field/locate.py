"""Where on the earth the features of a file lie: coordinate systems, swapped and wrapped degrees, stray places."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from uavaou.arrays import Bools, Floats
from uavaou.errors import InputError
from uavaou.field.features import DEGREES, METRES, UNSTATED, Feature, Reading, extra
from uavaou.fields import short

NEAR_KM = 10.0
_KM = 111.195  # of a degree of latitude
_LEAST_M = 20.0  # across a field in metres


def in_one_frame(reading: Reading, crs: str, notes: list[str]) -> list[Feature]:
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


def all_places(features: Iterable[Feature]) -> Floats:
    """The places of all features, (P, 2)."""
    return np.array([place for feature in features for place in feature.places], dtype=np.float64).reshape(-1, 2)


def _guessed_frame(reading: Reading, notes: list[str]) -> str:
    """Whether columns that are just x and y hold degrees: small, close to each other, and with many decimals.

    Raises:
        InputError: they could be both.
    """
    places = all_places(feature for feature in reading.features if feature.frame == UNSTATED)
    narrow = float(np.ptp(places, axis=0).max(initial=0)) < _LEAST_M
    small = narrow and (abs(places) <= 180).all()
    precise = (abs(places * 100 - np.rint(places * 100)) > 1e-6).mean() > 0.5
    if small and len(places) > 1 and (reading.headless or not precise or (abs(places[:, 1]) > 90).any()):
        raise InputError(
            f"{reading.path}: x and y could be metres or degrees: write a header of x_m, y_m or of lat, lon"
        )
    frame = DEGREES if small and precise and not reading.headless else METRES
    notes.append(
        f"{reading.path.name}: x and y are taken for {'longitude and latitude' if frame == DEGREES else 'metres'}"
    )
    if frame == METRES and (abs(places) > 90_000).all():
        notes.append(f"{reading.path.name}: they look like UTM: --crs EPSG:326.. or 327.. would keep coordinates")
    return frame


def _refuse_degrees(reading: Reading, features: Sequence[Feature]) -> None:
    places = all_places(features)
    if len(places) > 1 and (abs(places) <= [180, 90]).all() and 0 < np.ptp(places, axis=0).max() < 0.5:
        raise reading.error(
            features[0].where, f"{places[0].tolist()} is said to be metres and looks like degrees: give --crs degrees"
        )


def _from_crs(reading: Reading, features: list[Feature], crs: str) -> list[Feature]:
    """The features in degrees."""
    pyproj = extra("pyproj")
    try:
        transformer = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError:
        raise InputError(
            f"--crs {short(crs)}: no coordinate reference system; expected one such as EPSG:32632"
        ) from None
    places = all_places(features)
    degrees = np.stack(transformer.transform(*places.T), axis=-1)  # (P, 2)
    wrong = np.flatnonzero(~np.isfinite(degrees).all(axis=1))
    counts = np.cumsum([len(feature.places) for feature in features])
    if len(wrong):
        where = features[int(np.searchsorted(counts, wrong[0], side="right"))].where
        raise reading.error(where, f"{places[wrong[0]].tolist()} lies outside of {crs}")
    parts = np.split(degrees, counts[:-1])
    return [replace(f, places=tuple(map(tuple, part.tolist()))) for f, part in zip(features, parts, strict=True)]


def on_one_map(
    located: Sequence[tuple[Reading, list[Feature]]], near: Sequence[float] | None, notes: list[str]
) -> list[tuple[Reading, list[Feature]]]:
    """Features with latitudes and longitudes in order, and longitudes that do not jump."""
    found = []
    for reading, features in located:
        features = _without_null_island(reading, features, notes)
        if features:
            straight, swapped = _fault(features), _fault([_swapped(feature) for feature in features])
            middle = np.median(all_places(features), axis=0).tolist()
            far = near is not None and km_between(middle, near) > 500 and km_between(middle[::-1], near) < 100
            if (straight or far) and not swapped:
                features = [_swapped(feature) for feature in features]
                why = straight or "as given, they lie far from the others"
                notes.append(f"{reading.path.name}: latitude and longitude are swapped back ({why})")
            elif straight:
                raise InputError(f"{reading.path}: {straight}")
            first = near or features[0].places[0]
            features = [_near_longitude(feature, first[0]) for feature in features]
            near = near or np.median(all_places(features), axis=0).tolist()
        found.append((reading, features))
    return found


def _without_null_island(reading: Reading, features: list[Feature], notes: list[str]) -> list[Feature]:
    kept = [f for f in features if any(map(any, f.places))]
    if kept and len(kept) < len(features) and abs(all_places(kept)).max() > 1:
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
    return replace(feature, places=tuple((x + 360 * round((longitude - x) / 360), y) for x, y in feature.places))


def km_between(first: Sequence[float], second: Sequence[float]) -> float:
    """The distance of two places, on a sphere."""
    (x, y), (u, v) = (map(math.radians, place) for place in (first, second))
    haversine = math.sin((y - v) / 2) ** 2 + math.cos(y) * math.cos(v) * math.sin((x - u) / 2) ** 2
    return 2 * math.degrees(math.asin(min(math.sqrt(max(haversine, 0.0)), 1.0))) * _KM


def near_places(places: Floats, place: Sequence[float]) -> Bools:
    """Which places lie close to one, (P,)."""
    east, north = ((places - place) * [math.cos(math.radians(place[1])) * _KM, _KM]).T
    return np.asarray(np.hypot(east, north) <= NEAR_KM)
