"""Imported once by the server of the tests' processes: what every training would load anew."""

from uavaou import Scenario, World

world = World(Scenario.load("tiny"), 2, 0)
while not world.done:
    world.step(world.allowed_moves.argmax(-1))
