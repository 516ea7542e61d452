"""The words by which columns and properties are found, and numbers as people write them."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from functools import lru_cache

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
    "floor": "floor lower bottom",
    "ceiling": "ceiling upper top",
    "margin": "margin buffer",
    "height": "elevation altitude height elev alt ele z hohe hoehe altura altitud",
}
_AT_THE_END = ("x", "y", "height", "id")  # meanings whose words also stand for other things inside of a name
_WHOLE = {"station", "sensor", "site", "stop", "device", "node", "standort"}  # that are names where they stand alone
SLOTS = -1.0  # in place of the seconds of a unit of time


def _units(names: Mapping[float, str]) -> dict[str, float]:
    return {word: factor for factor, words_ in names.items() for word in words_.split()}


LENGTHS = _units({1.0: "m meter meters metre metres", 1e3: "km", 0.3048: "ft feet"})
TIMES = _units(
    {
        1.0: "s sec secs second seconds sek sekunden segundos",
        60.0: "m min mins minute minutes minuten minutos",
        3600.0: "h hr hrs hour hours std stunde stunden horas",
        86400.0: "d day days tag tage",
        1e-3: "ms",
        SLOTS: "slot slots",
    }
)
_UNITS = {*LENGTHS, "s", "sec", "min", "h", "deg", "degrees", "slots"}


def words(name: str) -> list[str]:
    """The words of a name, in small letters without accents: ``StationID`` and ``station_id`` are station, id."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_A-Za-z]+", plain)]


@lru_cache(maxsize=4096)
def meanings(names: tuple[str, ...]) -> Mapping[str, str]:
    """The name that stands for each meaning, as far as there is one; no name stands for two."""
    found: dict[str, str] = {}
    split = {name: words(name) for name in names}
    for meaning, known in _WORDS.items():
        order = {word: place for place, word in enumerate(known.split())}
        ranks = []
        for place, (name, parts) in enumerate(split.items()):
            parts = [part for part in parts if part not in _UNITS] or parts
            if name in found.values() or (meaning == "longitude" and "name" in parts):  # a long name
                continue
            inside = parts[:1] + parts[-1:] if meaning in _AT_THE_END else parts
            hits = [order[part] for part in inside if part in order and (len(parts) == 1 or part not in _WHOLE)]
            ranks += [(len(parts) > 1, min(hits), place, name)] if hits else []
        if ranks:
            found[meaning] = min(ranks)[-1]
    return found


def number(text: object) -> float:
    """A number as people write it; nan if it is none: ``1.234,5``, whose last comma or point is the decimal one."""
    plain = str(text).replace("−", "-").strip(" \u00a0°")
    if "," in plain and "." in plain:
        plain = plain.replace("," if plain.rindex(".") > plain.rindex(",") else ".", "")
    try:
        return float(plain.replace(",", "."))
    except ValueError:
        return math.nan


def unit(name: str, units: Mapping[str, float]) -> float:
    """The factor of the unit in a name; nan without one."""
    return next((units[part] for part in words(name)[::-1] if part in units), math.nan)
