"""Where on the earth the features of a file lie: coordinate systems, swapped and wrapped degrees, stray places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pyproj
import shapely

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.field.features import DEGREES, GEOD, METRES, UNSTATED, Feature, Reading, coordinates, kept, moved
from uavaou.fields import short

_LEAST_M, _LEAST_DEGREES = 20.0, 0.5  # across a field
_FAR_KM, _NEAR_KM = 500.0, 100.0  # between places that do not belong to one map, and that do


def in_one_frame(reading: Reading, crs: str, notes: list[str]) -> list[Feature]:
    """The features in degrees, or in metres without an origin."""
    found: list[Feature] = []
    frames = {feature.frame for feature in reading.features}
    for frame in sorted(frames):
        features = [feature for feature in reading.features if feature.frame == frame]
        meant = crs or _frame(reading, features, notes) if frame in (METRES, UNSTATED) else frame
        if meant not in (DEGREES, METRES):
            features, meant = _from_crs(reading, features, meant), DEGREES
        found += [replace(feature, frame=meant) for feature in features]
    if crs and not frames & {METRES, UNSTATED}:
        notes.append(f"{reading.path.name}: --crs {crs} is ignored: it holds degrees")
    return found


def _frame(reading: Reading, features: Sequence[Feature], notes: list[str]) -> str:
    """Whether columns hold degrees: small numbers, close to each other, and, just x and y, with many decimals.

    Raises:
        InputError: they could be both.
    """
    places, stated = coordinates(features), features[0].frame == METRES
    spread = np.ptp(places, axis=0).max()
    precise = (abs(places * 100 - np.rint(places * 100)) > 1e-6).mean() > 0.5
    narrow = (abs(places) <= [180, 90]).all() and spread < (_LEAST_DEGREES if stated else _LEAST_M)
    if len(places) > 1 and narrow and (stated or not precise) and spread > 0:
        raise InputError(
            f"{reading.path}: {features[0].where}: x and y, {places[0].tolist()}, could be metres or degrees: "
            "write a header of x_m, y_m or of lat, lon, or give --crs degrees or metres"
        )
    if stated:
        return METRES
    frame, name = (DEGREES, "longitude and latitude") if narrow and precise else (METRES, "metres")
    notes.append(f"{reading.path.name}: x and y are taken for {name}")
    if (abs(places) > 90_000).all():
        notes.append(f"{reading.path.name}: they look like UTM: --crs EPSG:326.. or 327.. would keep coordinates")
    return frame


def _from_crs(reading: Reading, features: list[Feature], crs: str) -> list[Feature]:
    """The features in degrees."""
    try:
        transformer = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.ProjError:
        raise InputError(
            f"--crs {short(crs)}: no coordinate reference system; expected one such as EPSG:32632"
        ) from None
    found = moved(features, lambda places: np.column_stack(transformer.transform(*places.T)))
    for feature, new in zip(features, found, strict=True):
        if not np.isfinite(coordinates([new])).all():
            place = coordinates([feature])[0].tolist()
            raise InputError(f"{reading.path}: {feature.where}: {place} lies outside of {crs}")
    return found


def on_one_map(reading: Reading, features: list[Feature], near: Floats | None, notes: list[str]) -> list[Feature]:
    """Features with latitudes and longitudes in order, and longitudes within half a turn of a place near them."""
    there = shapely.bounds([feature.geometry for feature in features]).any(axis=1)
    if there.any() and abs(coordinates(features)).max() > 1:
        features = kept(features, there, notes, f"places at 0, 0 of {reading.path.name} are ignored")
    fault, middle = fault_of(features), np.median(coordinates(features), axis=0)
    if near is not None and not fault and seems_swapped(near, middle):
        fault = "as given, they lie far from the others"
    if fault:
        features = moved(features, lambda places: places[:, ::-1])
        if fault_of(features):
            raise InputError(f"{reading.path}: {fault}")
        notes.append(f"{reading.path.name}: latitude and longitude are swapped back ({fault})")
    first = coordinates(features)[0, 0] if near is None else near[0]
    return moved(features, lambda places: places + np.rint((first - places) / 360) * [360, 0])


def seems_swapped(place: Floats, other: Floats) -> bool:
    """Whether two places (longitude, latitude) lie far apart as given, and near each other with one of them swapped."""
    return bool(km_from(place, other)[0] > _FAR_KM and km_from(place, other[::-1])[0] < _NEAR_KM)


def fault_of(features: Sequence[Feature]) -> str:
    """What is wrong with the first place that is none on the earth; empty without one."""
    places, index = shapely.get_coordinates([feature.geometry for feature in features], return_index=True)
    for k in np.flatnonzero((abs(places) > [360, 90]).any(axis=1))[:1]:
        longitude, latitude = places[k]
        name, value, most = ("latitude", latitude, 90) if abs(latitude) > 90 else ("longitude", longitude, 180)
        return f"{features[index[k]].where}: {name} = {value:.9g}: must be from -{most} to {most}"
    return ""


def km_from(place: Sequence[float] | Floats, places: Floats) -> Floats:
    """The distances of places (P, 2) from one, all in degrees (longitude, latitude), (P,) km."""
    places = places.reshape(-1, 2)
    x, y = np.broadcast_to(place, places.shape).T
    return np.asarray(GEOD.inv(x, y, *places.T)[2], dtype=np.float64) / 1000
