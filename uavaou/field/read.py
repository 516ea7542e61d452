"""From a path to the features in that file, whatever its format: its content decides, not its ending."""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path

from uavaou.errors import InputError
from uavaou.field import ENDINGS
from uavaou.field.features import Reading
from uavaou.field.maps import GEOMETRIES, read_geojson, read_plan, read_waypoints, read_xml
from uavaou.field.tables import read_records, read_text_table, read_workbook
from uavaou.files import read_bytes

_MOST_BYTES = 64_000_000
_MOST_UNPACKED = 256_000_000
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
        with reading.at("the archive", path.name, "one that is not damaged"):
            _read_packed(reading, data)
    elif data[:64].replace(b"\0", b"").lstrip(b"\xff\xfe\xef\xbb\xbf \r\n\t").startswith(b"<"):
        read_xml(reading, data)
    else:
        _read_text(reading, _decoded(reading, data))
    reading.settle()
    return reading


def _read_packed(reading: Reading, data: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        if sum(entry.file_size for entry in archive.infolist()) > _MOST_UNPACKED:
            raise InputError(f"{reading.path}: more than {_MOST_UNPACKED:,} bytes when unpacked")
        if "xl/workbook.xml" in names:
            parts = (archive.read(name).replace(b"\0", b"") for name in names if name.endswith((".xml", ".rels")))
            if any(b"<!" in part.replace(b"<!--", b"").replace(b"<![CDATA", b"") for part in parts):
                raise InputError(f"{reading.path}: a workbook with a DOCTYPE is not read")
            read_workbook(reading, data)
            return
        maps = sorted((name for name in names if name.lower().endswith(".kml")), key=lambda name: name != "doc.kml")
        if not maps:
            raise InputError(f"{reading.path}: an archive without a KML map or a workbook: unpack it")
        if len(maps) > 1:
            reading.notes.append(f"of {len(maps)} maps in it, {maps[0]} alone is read")
        read_xml(reading, archive.read(maps[0]))


def _decoded(reading: Reading, data: bytes) -> str:
    """The text of bytes in UTF-8 or, with a byte-order mark, UTF-16; else in Windows' Western letters."""
    try:
        text = data.decode("utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
        reading.notes.append("not UTF-8: read as Latin-1; letters of names may be wrong")
    if "\0" in text:
        raise InputError(f"{reading.path}: not a text file, and of none of the formats {', '.join(ENDINGS)}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _read_text(reading: Reading, text: str) -> None:
    start = text.lstrip()
    if not start:
        raise InputError(f"{reading.path}: is empty")
    if start.startswith("QGC WPL"):
        read_waypoints(reading, start)
        return
    if start[0] not in "{[":
        read_text_table(reading, text)
        return
    try:
        content = json.loads(start, parse_constant=lambda word: math.nan)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{reading.path}: cannot be read as JSON: {error}") from None
    if isinstance(content, list) and all(isinstance(x, dict) and x.get("type") == "Feature" for x in content):
        content = {"type": "FeatureCollection", "features": content}
    kind = content.get("type") if isinstance(content, dict) else None
    if isinstance(content, dict) and str(content.get("fileType")).lower() == "plan":
        read_plan(reading, content)
    elif kind in ("FeatureCollection", "Feature", *GEOMETRIES):
        read_geojson(reading, content)
    elif kind == "Topology":
        raise InputError(f"{reading.path}: is TopoJSON: save it as GeoJSON")
    else:
        read_records(reading, content)
