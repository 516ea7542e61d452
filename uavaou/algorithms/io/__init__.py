"""Safe save and load: arrays and JSON, no pickle."""
