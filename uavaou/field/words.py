"""The words by which columns and properties are found, and numbers as people write them."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence

# Of each meaning, the words of a name, the surest first.
_WORDS = {
    "latitude": "latitude lat latitud latitudine breite breitengrad 纬度 緯度 위도 широта",
    "longitude": "longitude lon lng long longitud longitudine lange laenge langengrad laengengrad 经度 經度 経度 경도 "
    "долгота",
    "x": "x easting east rechtswert ostwert este",
    "y": "y northing north hochwert nordwert norte",
    "place": "geometry geom wkt geolocation coordinates coordinate coords latlng latlon location position point "
    "georeference koordinaten coordenadas",
    "id": "id identifier code number uuid uid nr num ref kennung",
    "name": "name title label stationsname bezeichnung nom nombre nome station sensor site stop device node standort",
    "interval": "interval period intervall periode intervalo periodo intervalle cadence takt",
    "role": "role kind type category class typ art tipo rolle",
    "radius": "radius",
    "floor": "floor lower bottom",
    "ceiling": "ceiling upper top",
    "margin": "margin buffer",
    "height": "elevation altitude height elev alt ele z hohe hoehe altura altitud",
}
_AT_THE_END = ("x", "y", "height", "id", "radius")  # meanings whose words also stand for other things inside of a name
_WHOLE = {"station", "sensor", "site", "stop", "device", "node", "standort"}  # that are names where they stand alone
_LENGTHS = {**dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0), "km": 1e3, "ft": 0.3048, "feet": 0.3048}
_UNITS = {*_LENGTHS, "s", "sec", "min", "h", "deg", "degrees", "slots"}
_SECONDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunden", "segundos"), 1.0),
    **dict.fromkeys(("m", "min", "mins", "minute", "minutes", "minuten", "minutos"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours", "std", "stunde", "stunden", "horas"), 3600.0),
    **dict.fromkeys(("d", "day", "days", "tag", "tage"), 86400.0),
    "ms": 1e-3,
}
_ANGLE = re.compile(
    r"([NSEWO])?\s*(-?[\d.,]+)\s*[°ºd]?(?:\s*(\d+(?:[.,]\d+)?)\s*['′’m]?(?:\s*(\d+(?:[.,]\d+)?)\s*(?:\"|″|”|''|s)?)?)?"
    r"\s*([NSEWO])?",
    re.IGNORECASE,
)
_LONGEST = 40  # letters of a number
_DURATION = re.compile(r"(?:PT)?\s*([\d.,]+(?:e[-+]?\d+)?)\s*([^\W\d_]*)\.?", re.IGNORECASE)
SLOTS = -1.0  # in place of a unit's seconds


def words(name: str) -> list[str]:
    """The words of a name, in small letters without accents: ``StationID`` and ``station_id`` are station, id."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_A-Za-z]+", plain)
    return [part.lower() for part in parts]


def meanings(names: Sequence[str]) -> dict[str, str]:
    """The name that stands for each meaning, as far as there is one; no name stands for two."""
    found: dict[str, str] = {}
    split = {name: words(name) for name in names}
    for meaning, known in _WORDS.items():
        order = {word: place for place, word in enumerate(known.split())}
        ranks = []
        for place, (name, parts) in enumerate(split.items()):
            parts = [part for part in parts if part not in _UNITS] or parts
            if meaning == "longitude" and "name" in parts:  # a long name
                continue
            inside = parts[:1] + parts[-1:] if meaning in _AT_THE_END else parts
            hits = [order[part] for part in inside if part in order and (len(parts) == 1 or part not in _WHOLE)]
            if hits and name not in found.values():
                ranks.append((len(parts) > 1, min(hits), place, name))
        if ranks:
            found[meaning] = min(ranks)[-1]
    return found


def number(text: object) -> float:
    """A number as people write it, in degrees if it is an angle; nan if it is none: ``1.234,5``, ``46° 6' N``."""
    if isinstance(text, int | float):
        return float(text) if abs(text) < 1e300 else math.nan
    plain = str(text).strip().replace("−", "-").replace("\u00a0", "")
    try:
        return float(plain)
    except ValueError:
        pass
    if len(plain) < _LONGEST and (angle := _ANGLE.fullmatch(plain)):
        before, degrees, minutes, seconds, after = angle.groups()
        value = _plain_number(degrees)
        size = abs(value) + _plain_number(minutes or "0") / 60 + _plain_number(seconds or "0") / 3600
        south_or_west = (before or after or "N").upper() in "SW"
        return -size if south_or_west or degrees.startswith("-") else size
    return math.nan


def _plain_number(text: str) -> float:
    """A number without an exponent, whose last comma or point is the decimal one if both occur."""
    if "," in text and "." in text:
        text = text.replace("," if text.rindex(".") > text.rindex(",") else ".", "")
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan


def unit_seconds(name: str) -> float:
    """The seconds of the unit of time in a name, :data:`SLOTS`, or nan without one."""
    parts = words(name)
    return SLOTS if "slots" in parts else next((_SECONDS[part] for part in parts[::-1] if part in _SECONDS), math.nan)


def unit_metres(name: str) -> float:
    """The metres of the unit of length in a name; nan without one."""
    return next((_LENGTHS[part] for part in words(name)[::-1] if part in _LENGTHS), math.nan)


def duration(text: object, default: float = math.nan) -> tuple[float, float]:
    """A length of time as its number and the seconds of its unit, or ``default`` without one: ``5 min``, ``PT5M``."""
    found = _DURATION.fullmatch(str(text).strip()[:_LONGEST])
    if found is None:
        return math.nan, default
    unit = found[2].lower()
    seconds = default if not unit else SLOTS if unit in ("slot", "slots") else _SECONDS.get(unit, math.nan)
    return (_plain_number(found[1]) if "e" not in found[1].lower() else number(found[1])), seconds
