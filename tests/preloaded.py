"""Imported once by the server of the tests' processes: what every training would load anew."""

from importlib import import_module

from uavaou import Scenario, World
from uavaou.planners.tuned import LocalGreedyTuned
from uavaou.threads import use_threads

import_module("torch._dynamo")  # which the first gradient or step of an optimiser imports, with sympy

scenario = Scenario.load("tiny")
world = World(scenario, 2, 0)
while not world.done:
    world.step(world.allowed_moves.argmax(-1))

use_threads(1)  # a process with several is not to be forked
LocalGreedyTuned(slots=1).plan(scenario, scenario.draw_layout())
use_threads(None)
