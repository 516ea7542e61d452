"""A field on the earth: what leads from coordinates to a scenario, and back. On the scenario alone."""

ENDINGS = (".geojson", ".json", ".kml", ".kmz", ".gpx", ".plan", ".waypoints", ".csv", ".tsv", ".txt", ".xlsx")
