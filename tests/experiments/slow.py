"""A plugin: the waits are so long that another training begins in them, on the busiest machine."""

from tests.experiments import paced

paced.pause_s = 5.0
