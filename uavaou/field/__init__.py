"""A field on the earth: what leads from coordinates to a scenario, and back. On the scenario alone."""
