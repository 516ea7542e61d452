"""A rule that learns nothing and reads local information alone: each UAV follows the pull of its own devices."""

from typing import ClassVar

import numpy as np

from uavaou.arrays import Bools, Floats, Ints
from uavaou.mission_fields import FULL
from uavaou.world import World
from uavaou.world.flight import STAY, targets
from uavaou.world.knowledge import Knowledge
from uavaou.world.partition import survivors_parts
from uavaou.world.pull import estimated_age, steps_left

_LOW = 0.1  # of a battery beside its reserve: with less, a UAV over a station stays there for another one
_REACH = 1.0  # lambda, grid steps: the pull of a device falls by 1/e with each


class LocalGreedy:
    """Fly each UAV to the devices whose nearest CDS is its own, by its own estimate of their ages.

    It makes the allowed move to the cell c with the largest

        sum_i w_ui A_i exp(-d_i(c) / lambda),

    lambda being one grid step. A_i is the UAV's own estimate of the age sum of device i, from k_i and the slot in which
    it last collected i itself; a device in its range is collected now and has A_i = 0. d_i(c) are the steps from c to
    the nearest cell with at least half of the UAV's best coverage probability for i. w_ui is 1 for the devices of the
    UAV and 0 for all others: a device belongs to the UAV with the nearest CDS among those that can collect it. Where
    messages tell that others are lost (``links``), it belongs to one of those that are left. Over a station, a UAV with
    a low battery stays for a full one.

    All of this is part of the observation ``local``: the map and every CDS are told before take-off, the rest is the
    UAV's own. Ties go to the lowest UAV and to the first move, which is to stay.
    """

    knows: ClassVar[Knowledge] = "local"
    lives_with: ClassVar[tuple[str, ...]] = ("uplinks_per_slot", "energy", "links")

    def reset(self, world: World, seed: int) -> None:
        """Compute the pull of each device on each cell, for each layout; draw nothing from ``seed``."""
        scenario, steps = world.scenario, steps_left(world).astype(np.float64)  # (L, U, C, I)
        self._reaches = np.asarray((steps < np.inf).any(axis=2))  # (L, U, I)
        self._near = np.exp(-steps / _REACH)  # (L, U, C, I)
        everybody = np.ones(scenario.uavs, dtype=np.bool_)
        self._pull = self._owned(world, everybody)[:, :, None] * self._near  # (L, U, C, I)
        self._target = targets(scenario)  # (T, C, 5)

    def _owned(self, world: World, alive: Bools) -> Bools:
        """Which devices belong to each UAV where these UAVs are left, (L, U, I)."""
        owner = self.owners(world, self._reaches & alive[:, None], alive)  # (L, I)
        return np.asarray(owner[:, None] == np.arange(len(alive))[:, None])

    def act(self, world: World) -> tuple[Ints, Bools | None]:
        """Return the allowed move of each UAV with the largest pull, (N, U)."""
        missions, uavs = world.missions, world.scenario.uavs
        age = estimated_age(world.slot, self._last(world), world.update_period[:, None])  # (N, U, I) slots
        cell = world.cells @ [world.scenario.rows, 1]  # (N, U)
        layout = (np.arange(missions) % len(self._pull))[:, None, None]  # (N, 1, 1), all 0 for a common layout
        uav = np.arange(uavs)
        target = self._target[uav % len(self._target), cell]  # (N, U, 5)
        pull = self._pull[layout, uav[:, None], target]  # (N, U, 5, I)
        self._share_out(world, pull, layout[:, 0, 0], target)
        # A matrix product may round differently with N; near-ties would then depend on the batch.
        value = np.einsum("nui,numi->num", age.astype(np.float64), pull)
        moves = np.where(world.allowed_moves, value, -1.0).argmax(axis=-1)  # (N, U)
        if (batteries := world.operations.batteries) is not None:
            low = batteries.charge - batteries.reserve < _LOW * FULL  # (N, U)
            moves = np.where(batteries.at_station(world.cells) & low, STAY, moves)
        return moves, None

    def _share_out(self, world: World, pull: Floats, layout: Ints, target: Ints) -> None:
        """Put the pull of the devices that now belong to it in place of its own, (N, U, 5, I), of each UAV that knows
        of a loss; layouts (N,), targets (N, U, 5)."""
        knowledge = world.operations.knowledge
        if knowledge is None or not (lost := knowledge.lost(world.slot)).any():
            return
        for alive in np.unique(~lost[lost.any(axis=-1)], axis=0):  # (U,)
            n, u = np.nonzero((lost == ~alive).all(axis=-1))
            owned = self._owned(world, alive)[layout[n], u]  # (M, I)
            pull[n, u] = owned[:, None] * self._near[layout[n, None], u[:, None], target[n, u]]

    def _last(self, world: World) -> Ints:
        """Return the slot in which each UAV last collected each device, (N, U, I), this slot's collections included."""
        # The moves do not change those.
        return np.where(world.collecting, world.slot, world.last_collection_by)

    def owners(self, world: World, reaches: Bools, alive: Bools) -> Ints:
        """Return the UAV that each device belongs to, (L, I), of those that are ``alive``, (U,).

        ``reaches`` is where one of these can collect it, (L, U, I).
        """
        cds = world.flight.cds * world.scenario.grid_step_m  # (U, 2) m
        away = np.abs(world.device_positions[:, None] - cds[:, None]).sum(axis=-1)  # (L, U, I) m
        owner: Ints = np.where(reaches, away, np.inf).argmin(axis=1)
        return owner


class LocalGreedyParts(LocalGreedy):
    """The rule of ``local-greedy``, in which each UAV serves its part of the map.

    The parts of :func:`uavaou.world.partition.partition` take the place of the nearest CDS. That plan is a function of
    the map alone, so that it too is told before take-off.
    """

    def owners(self, world: World, reaches: Bools, alive: Bools) -> Ints:
        """Return the UAV whose part each device is in, (L, I)."""
        return survivors_parts(world, alive)
