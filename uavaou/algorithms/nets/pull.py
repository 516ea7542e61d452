"""Devices pull, moves follow: a term of each move's logit or value that is a rule at first, and is learned from there.

Each device has a score. Each move feels it through the grid steps that the move would leave to where the UAV collects
the device well:

    pull_m = beta log(exp(-400) + sum_i exp(score_i - steps_im / reach_i)),
    score_i = log age_i + 25 part (own_i - 1) + f_i,    reach_i = lambda exp(g_i)

age_i is what the UAV expects at the end of the slot, own_i is 1 for the devices of its part of the map. The set encoder
gives f and g, numbers of the device's token, which are 0 at first. With lambda = 1 and a large part, the likeliest move
is then that of the rule ``local-greedy-parts``. A device that has just been collected does not pull. Where none pulls,
the pull of nothing, exp(-400), makes all moves equal, and of equal moves the first is the best by a hair, as in that
rule. Sums are taken relative to what the first move feels most, so that they hold however far all devices are.

The sum does not depend on the order of devices, and pulls are turned and mirrored with the map. A learned term on a
controller is residual policy learning (Silver et al. 2018, arXiv 1812.06298); moves that follow attraction are
artificial potential fields (Khatib 1986).
"""

from functools import cache
from importlib import import_module
from typing import Any

import torch as th
from torch import Tensor, nn
from torch.nn import functional

from uavaou.world.pull import NOTHING, OTHERS, SCORE_RANGE, TIE
from uavaou.world.views import MOVES, PULL, RowLayout

CHANGES = 2  # numbers of a device's token: of its score, and of its reach


class Pull(nn.Module):
    """The pull of all devices on each move.

    Args:
        layout: of rows of entities.
        sharpness: beta at first; learned.
        part: by how much a device of another UAV's part pulls less, in units of 25 grid steps, where the UAV has to
            guess its age, and where it is told; learned.

    Attributes:
        columns: first column of the pulls, of the flags of own parts and of those of presence, and the way to the next.
    """

    def __init__(self, layout: RowLayout, sharpness: float, part: tuple[float, float] = (40.0, 40.0)) -> None:
        super().__init__()
        own, present = (layout.token_feature("devices", name) for name in ("own_part", "present"))
        self.columns = layout.token_feature("pulls", PULL[0]).start, own.start, present.start, own.step
        self.numbers = nn.Parameter(th.tensor([sharpness, 1.0, *part]).log())  # beta, lambda, part twice

    def forward(self, rows: Tensor, changes: Tensor) -> Tensor:
        """Return the pull of each move, (B, 5), at most 0.

        Args:
            rows: (B, columns).
            changes: numbers of the devices' scores, and then of their reaches, (B, 2 I).
        """
        fast = compiled_module("pulls")
        if fast is not None and fast.supports(rows):
            pulls: Tensor = fast.pull(rows, changes, self.numbers, self.columns)
            return pulls
        return self.define(rows, changes)

    @th.no_grad()
    def rescale(self, ratio: Tensor) -> None:
        """Multiply the pulls by ``ratio``."""
        self.numbers[0] += ratio.log()

    def define(self, rows: Tensor, changes: Tensor) -> Tensor:
        """Return what :meth:`forward` does, by torch's operators."""
        first, own, present, width = self.columns
        devices = changes.shape[1] // CHANGES
        pulls = rows[:, first : first + devices * len(PULL)].reshape(len(rows), devices, len(PULL))
        own, there = (rows[:, at : at + devices * width : width] for at in (own, present))  # (B, I) each
        return self.combine(own, there, pulls, changes)

    def combine(self, own: Tensor, there: Tensor, pulls: Tensor, changes: Tensor) -> Tensor:
        """Return the same for the flags of own parts and of presence (B, I), and the tokens of pulls (B, I, 7)."""
        sharpness, reach, part, part_shared = self.numbers.exp().unbind()
        score_change, reach_change = changes.tanh().chunk(CHANGES, dim=1)  # (B, I) each
        part = th.where(pulls[..., -1] > 0.5, part_shared, part)  # (B, I)
        score = pulls[..., 0].log() + OTHERS * part * (own - 1) + SCORE_RANGE * score_change
        felt = score[..., None] - pulls[..., 1:-1] / (reach * reach_change.exp())[..., None]  # (B, I, 5)
        felt = felt.masked_fill(there[..., None] < 0.5, -th.inf)
        total = functional.pad(felt, (0, 0, 1, 0), value=NOTHING).logsumexp(dim=1)  # (B, 5)
        order = th.arange(MOVES, device=total.device)
        return sharpness * (total - total.amax(dim=1, keepdim=True).detach() - TIE * order)


@cache
def compiled_module(name: str) -> Any:
    """Return the module of that name in ``algorithms/fast``; None where that folder has been deleted."""
    try:
        return import_module(f"uavaou.algorithms.fast.{name}")  # not before: that package imports the learners
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("uavaou.algorithms.fast"):
            raise
        return None
