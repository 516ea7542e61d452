"""Where on the earth the features of a file lie: coordinate systems, swapped and wrapped degrees, stray places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pyproj
import shapely

from uavaou.arrays import Floats
from uavaou.errors import InputError
from uavaou.field.features import DEGREES, GEOD, METRES, UNSTATED, Feature, Reading, coordinates, moved
from uavaou.fields import short

_LEAST_M = 20.0  # across a field in metres


def in_one_frame(reading: Reading, crs: str, notes: list[str]) -> list[Feature]:
    """The features in degrees, or in metres without an origin."""
    found: list[Feature] = []
    frames = {feature.frame for feature in reading.features}
    for frame in sorted(frames):
        features = [feature for feature in reading.features if feature.frame == frame]
        meant = crs or frame if frame in (METRES, UNSTATED) else frame
        if meant == UNSTATED:
            meant = _guessed_frame(reading, features, notes)
        elif meant == METRES:
            _refuse_degrees(reading, features)
        if meant not in (DEGREES, METRES):
            features, meant = _from_crs(reading, features, meant), DEGREES
        found += [replace(feature, frame=meant) for feature in features]
    if crs and not frames & {METRES, UNSTATED}:
        notes.append(f"{reading.path.name}: --crs {crs} is ignored: it holds degrees")
    return found


def _guessed_frame(reading: Reading, features: Sequence[Feature], notes: list[str]) -> str:
    """Whether columns that are just x and y hold degrees: small, close to each other, and with many decimals.

    Raises:
        InputError: they could be both.
    """
    places = coordinates(features)
    small = np.ptp(places, axis=0).max() < _LEAST_M and (abs(places) <= 180).all()
    precise = (abs(places * 100 - np.rint(places * 100)) > 1e-6).mean() > 0.5
    if small and len(places) > 1 and (not precise or (abs(places[:, 1]) > 90).any()):
        raise InputError(
            f"{reading.path}: x and y could be metres or degrees: write a header of x_m, y_m or of lat, lon"
        )
    frame, name = (DEGREES, "longitude and latitude") if small and precise else (METRES, "metres")
    notes.append(f"{reading.path.name}: x and y are taken for {name}")
    if (abs(places) > 90_000).all():
        notes.append(f"{reading.path.name}: they look like UTM: --crs EPSG:326.. or 327.. would keep coordinates")
    return frame


def _refuse_degrees(reading: Reading, features: Sequence[Feature]) -> None:
    places = coordinates(features)
    if len(places) > 1 and (abs(places) <= [180, 90]).all() and 0 < np.ptp(places, axis=0).max() < 0.5:
        raise InputError(
            f"{reading.path}: {features[0].where}: {places[0].tolist()} is said to be metres and looks like degrees: "
            "give --crs degrees"
        )


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


def on_one_map(
    located: Sequence[tuple[Reading, list[Feature]]], near: Sequence[float] | None, notes: list[str]
) -> list[tuple[Reading, list[Feature]]]:
    """Features with latitudes and longitudes in order, and longitudes that do not jump."""
    found = []
    for reading, features in located:
        features = _without_null_island(reading, features, notes)
        if features:
            swapped = moved(features, lambda places: places[:, ::-1])
            fault, of_swapped = _fault(features), _fault(swapped)
            middle = np.median(coordinates(features), axis=0)
            far = near is not None and km_from(near, [middle])[0] > 500 and km_from(near, [middle[::-1]])[0] < 100
            if (fault or far) and not of_swapped:
                features = swapped
                why = fault or "as given, they lie far from the others"
                notes.append(f"{reading.path.name}: latitude and longitude are swapped back ({why})")
            elif fault:
                raise InputError(f"{reading.path}: {fault}")
            first = (near or coordinates(features)[0])[0]
            # Longitudes within half a turn of the first one, across the antimeridian.
            features = moved(features, partial(_near, first))
            near = near or np.median(coordinates(features), axis=0).tolist()
        found.append((reading, features))
    return found


def _near(longitude: float, places: Floats) -> Floats:
    return np.asarray(places + np.rint((longitude - places) / 360) * [360, 0])


def _without_null_island(reading: Reading, features: list[Feature], notes: list[str]) -> list[Feature]:
    there = shapely.bounds([feature.geometry for feature in features]).any(axis=1)
    kept = [feature for feature, is_there in zip(features, there, strict=True) if is_there]
    if kept and len(kept) < len(features) and abs(coordinates(kept)).max() > 1:
        notes.append(f"{reading.path.name}: {len(features) - len(kept)} places at 0, 0 are ignored")
        return kept
    return features


def _fault(features: Sequence[Feature]) -> str:
    """What is wrong with the first place that is none on the earth; empty without one."""
    places, index = shapely.get_coordinates([feature.geometry for feature in features], return_index=True)
    for k in np.flatnonzero((abs(places) > [360, 90]).any(axis=1))[:1]:
        longitude, latitude = places[k]
        name, value, most = ("latitude", latitude, 90) if abs(latitude) > 90 else ("longitude", longitude, 180)
        return f"{features[index[k]].where}: {name} = {value:.9g}: must be from -{most} to {most}"
    return ""


def km_from(place: Sequence[float] | Floats, places: Any) -> Floats:
    """The distances of places (P, 2) from one, all in degrees (longitude, latitude), (P,) km."""
    x, y, longitude, latitude = np.broadcast_arrays(*place, *np.asarray(places, dtype=np.float64).reshape(-1, 2).T)
    return np.asarray(GEOD.inv(x, y, longitude, latitude)[2], dtype=np.float64) / 1000
