"""From a path to the features in that file, whatever its format: its content decides, not its ending."""

from __future__ import annotations

import codecs
import io
import json
import math
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.field.features import Reading
from uavaou.field.maps import GEOMETRIES, parse_xml, read_geojson, read_gpx, read_kml
from uavaou.field.missions import read_plan, read_waypoints
from uavaou.field.tables import read_records, read_text_table, read_workbook
from uavaou.files import read_bytes

ENDINGS = (".geojson", ".json", ".kml", ".kmz", ".gpx", ".plan", ".waypoints", ".csv", ".tsv", ".txt", ".xlsx")
_MOST_BYTES = 64_000_000
_MOST_UNPACKED = 256_000_000
_DAMAGES = (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError)
_OTHERS = {  # the first bytes of formats that are not read
    b"\xd0\xcf\x11\xe0": "an old workbook: save it as .xlsx or .csv",
    b"\x00\x00'\n": "a shapefile: save it as GeoJSON",
    b"SQLite format 3": "a database, such as a GeoPackage: save the layer as GeoJSON",
    b"%PDF": "a PDF",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"\x1f\x8b": "packed by gzip: unpack it",
}


def read_file(path: Path) -> Reading:
    """Read a file.

    Raises:
        InputError: it cannot be read, or is of none of the formats; it names the place in the file.
    """
    data = read_bytes(path, _MOST_BYTES)
    reading = Reading(path)
    for first, what in _OTHERS.items():
        if data.startswith(first):
            raise InputError(f"{path}: is {what}")
    if data.startswith(b"PK\x03\x04"):
        _read_packed(reading, data)
    elif data.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<") or data[:6].replace(b"\0", b"").lstrip(
        b"\xff\xfe\xef\xbb\xbf"
    ).startswith(b"<"):
        _read_xml(reading, data)
    else:
        _read_text(reading, _decoded(reading, data))
    return reading


def _read_packed(reading: Reading, data: bytes) -> None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            if sum(entry.file_size for entry in archive.infolist()) > _MOST_UNPACKED:
                raise InputError(f"{reading.path}: more than {_MOST_UNPACKED:,} bytes when unpacked")
            if "xl/workbook.xml" in names:
                parts = (archive.read(name) for name in names if name.endswith((".xml", ".rels")))
                if any(
                    b"<!" in part.replace(b"\0", b"").replace(b"<!--", b"").replace(b"<![CDATA", b"") for part in parts
                ):
                    raise InputError(f"{reading.path}: a workbook with a DOCTYPE is not read")
                return read_workbook(reading, data)
            maps = [name for name in names if name.lower().endswith(".kml")]
            if not maps:
                raise InputError(f"{reading.path}: an archive without a KML map or a workbook: unpack it")
            chosen = next((name for name in maps if name.lower() == "doc.kml"), maps[0])
            if len(maps) > 1:
                reading.notes.append(f"of {len(maps)} maps in it, {chosen} alone is read")
            return _read_xml(reading, archive.read(chosen))
    except InputError:
        raise
    except (*_DAMAGES, OSError, ValueError) as error:
        raise InputError(f"{reading.path}: a damaged archive: {error}") from None


def _read_xml(reading: Reading, data: bytes) -> None:
    root = parse_xml(reading, data)
    kind = str(root.tag).rpartition("}")[2].lower()
    readers: dict[str, Callable[[Reading, Any], None]] = {"kml": read_kml, "gpx": read_gpx}
    if kind not in readers:
        raise InputError(f"{reading.path}: XML of {kind[:40]}: expected KML or GPX")
    readers[kind](reading, root)


def _decoded(reading: Reading, data: bytes) -> str:
    """The text of bytes in UTF-8 or UTF-16, with or without a byte-order mark; else in Windows' Western letters."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif data[1:64:2].count(0) > 20 or data[:64:2].count(0) > 20:
        encoding = "utf-16-le" if data[1:2] == b"\0" else "utf-16-be"
    else:
        encoding = "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("cp1252" if not {0x81, 0x8D, 0x8F, 0x90, 0x9D} & set(data) else "latin-1")
        reading.notes.append("not UTF-8: read as Latin-1; letters of names may be wrong")
    if "\0" in text:
        raise InputError(f"{reading.path}: not a text file, and of none of the formats {', '.join(ENDINGS)}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _read_text(reading: Reading, text: str) -> None:
    start = text.lstrip()
    if not start:
        raise InputError(f"{reading.path}: is empty")
    if start.startswith("QGC WPL"):
        return read_waypoints(reading, start)
    if start[0] not in "{[":
        return read_text_table(reading, text)
    try:
        content = json.loads(start, parse_constant=lambda word: math.nan)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{reading.path}: cannot be read as JSON: {error}") from None
    if isinstance(content, dict) and str(content.get("fileType")).lower() == "plan":
        return read_plan(reading, content)
    if isinstance(content, dict) and content.get("type") in ("FeatureCollection", "Feature", *GEOMETRIES):
        return read_geojson(reading, content)
    if (
        isinstance(content, list)
        and content
        and all(isinstance(x, dict) and x.get("type") == "Feature" for x in content)
    ):
        return read_geojson(reading, {"type": "FeatureCollection", "features": content})
    if isinstance(content, dict) and content.get("type") == "Topology":
        raise InputError(f"{reading.path}: is TopoJSON: save it as GeoJSON")
    return read_records(reading, content)
