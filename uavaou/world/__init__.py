"""The physics: arrays over missions, loops compiled; knows nothing of learning."""

from uavaou.world.views import Views
from uavaou.world.world import MissionMetrics, World

__all__ = ["MissionMetrics", "Views", "World"]
