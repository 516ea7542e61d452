"""Small files like those that people bring: the same three sensors, a station, an outline and a zone in each format."""

import io
import json
import zipfile

import openpyxl

PLACES = {"weir": (46.1012, 7.2210), "barn": (46.1052, 7.2330), "hut": (46.1080, 7.2270)}  # latitude, longitude
HOME = (46.1020, 7.2220)
OUTLINE = [(46.1000, 7.2200), (46.1000, 7.2350), (46.1090, 7.2350), (46.1090, 7.2200)]
ZONE = [(46.1030, 7.2260), (46.1030, 7.2290), (46.1050, 7.2290), (46.1050, 7.2260)]


def feature(shape: str, coordinates: object, **properties: object) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": shape, "coordinates": coordinates}}


def ring(corners: list[tuple[float, float]]) -> list[list[list[float]]]:
    return [[[longitude, latitude] for latitude, longitude in [*corners, corners[0]]]]


FEATURES = [
    *(feature("Point", [lon, lat], name=name, interval="2 min") for name, (lat, lon) in PLACES.items()),
    feature("Point", [HOME[1], HOME[0]], type="base station"),
    feature("Polygon", ring(OUTLINE), type="outline"),
    feature("Polygon", ring(ZONE), type="no-fly", name="school", ceiling_m=120),
]


def _kml_ring(corners: list[tuple[float, float]]) -> str:
    text = " ".join(f"{lon},{lat},0" for lat, lon in [*corners, corners[0]])
    inner = f"<LinearRing><coordinates>{text}</coordinates></LinearRing>"
    return f"<Polygon><outerBoundaryIs>{inner}</outerBoundaryIs></Polygon>"


KML = (
    '<?xml version="1.0" encoding="UTF-8"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Folder><name>sensors</name>'
    + "".join(
        f"<Placemark><name>{name}</name><ExtendedData><Data name='interval'><value>2 min</value></Data></ExtendedData>"
        f"<Point><coordinates>{lon},{lat},0</coordinates></Point></Placemark>"
        for name, (lat, lon) in PLACES.items()
    )
    + f"</Folder><Placemark><name>Home</name><Point><coordinates>{HOME[1]},{HOME[0]}</coordinates></Point></Placemark>"
    + f"<Placemark><name>boundary</name>{_kml_ring(OUTLINE)}</Placemark>"
    + f"<Folder><name>no-fly zones</name><Placemark><name>school</name>{_kml_ring(ZONE)}</Placemark></Folder>"
    + "</Document></kml>"
)
GPX = (
    '<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">'
    + "".join(f'<wpt lat="{a}" lon="{o}"><ele>500</ele><name>{n}</name></wpt>' for n, (a, o) in PLACES.items())
    + '<trk><trkseg><trkpt lat="46.1" lon="7.2"/></trkseg></trk></gpx>'
)
PLAN = json.dumps(
    {
        "fileType": "Plan",
        "version": 1,
        "mission": {
            "version": 2,
            "plannedHomePosition": [*HOME, 500],
            "items": [
                {"type": "SimpleItem", "command": 22, "params": [0, 0, 0, None, *HOME, 60]},
                *({"type": "SimpleItem", "command": 16, "params": [5, 0, 0, None, *p, 60]} for p in PLACES.values()),
                {"type": "SimpleItem", "command": 20, "params": [0, 0, 0, 0, 0, 0, 0]},
            ],
        },
        "geoFence": {
            "version": 2,
            "polygons": [{"inclusion": True, "polygon": [list(corner) for corner in OUTLINE], "version": 1}],
            "circles": [{"inclusion": False, "circle": {"center": [46.104, 7.2275], "radius": 80}, "version": 1}],
        },
        "rallyPoints": {"version": 2, "points": [[46.1022, 7.2222, 50]]},
    }
)
_LINES = [(16, 0.0, HOME), (22, 0.0, HOME), *((16, 5.0, place) for place in PLACES.values())]
_LINES += [(5001, 4.0, corner) for corner in OUTLINE] + [(5004, 80.0, (46.104, 7.2275)), (20, 0.0, (0.0, 0.0))]
WPL = "QGC WPL 110\n" + "".join(
    f"{k}\t{int(k == 0)}\t3\t{command}\t{first}\t0\t0\t0\t{lat}\t{lon}\t60\t1\n"
    for k, (command, first, (lat, lon)) in enumerate(_LINES)
)
CSV = "# our sensors\nStation;Breite;Länge;Intervall (min);\n" + "".join(
    f"{name};{lat};{lon};2;\n".replace(".", ",") for name, (lat, lon) in PLACES.items()
)
TEXTS = {
    "map.geojson": json.dumps({"type": "FeatureCollection", "features": FEATURES}),
    "map.kml": KML,
    "map.gpx": GPX,
    "mission.plan": PLAN,
    "list.wpl": WPL,
    "table.csv": CSV,
    "records.json": json.dumps({"data": {"nodes": [{"id": n, "lat": a, "lng": o} for n, (a, o) in PLACES.items()]}}),
}


def packed_kml() -> bytes:
    with zipfile.ZipFile(file := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", KML)
    return file.getvalue()


def workbook() -> bytes:
    book = openpyxl.Workbook()
    book.active.append(["Notes of the campaign"])
    sheet = book.create_sheet("Sensors")
    sheet.append([None, None, None, None])
    sheet.append(["Name", "Latitude", "Longitude", "Interval [s]", None])
    for name, (latitude, longitude) in PLACES.items():
        sheet.append([name, latitude, str(longitude).replace(".", ","), 120])
    book.save(file := io.BytesIO())
    return file.getvalue()
