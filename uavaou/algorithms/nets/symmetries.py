"""The symmetries of the square: a map that is turned or mirrored asks for the same flight, turned or mirrored.

A network learns that only roughly. The mean of its outputs over all eight symmetries has it exactly, and decides better
than the network alone. Where it has learned one map alone, it has seen that from one side: there the mean is worse.
"""

from collections.abc import Callable
from itertools import product

import torch as th
from torch import Tensor

from uavaou.world.flight import STEP_OF_MOVE
from uavaou.world.views import MOVES, PULL, RowLayout

_PAIRS = (("own", "home"), ("teammates", ""), ("teammates", "home"), ("devices", ""))  # vectors (x, y) in the tokens
_ROWS = 256  # at once: eight views of a wide row take memory


class SquareSymmetries:
    """Rows of entities under the eight symmetries of the square.

    Args:
        layout: of the rows.

    Attributes:
        source: the column that each column of a view shows, (8, local); the first view is the row itself.
        sign: 1, or -1 where the view has the opposite of it, (8, local).
        move: the move of a view that is each move of the row, (8, 5).
    """

    def __init__(self, layout: RowLayout) -> None:
        moves, pulls = (layout.local_columns(name) for name in ("allowed_moves", "pulls"))
        assert moves is not None
        of_moves = [moves.start, *(() if pulls is None else range(pulls.start + 1, pulls.stop, len(PULL)))]
        columns = th.arange(layout.local_size)
        x, y = (
            th.cat([columns[layout.token_feature(tokens, f"{of}_{axis}".lstrip("_"))] for tokens, of in _PAIRS])
            for axis in "xy"
        )
        steps = STEP_OF_MOVE.tolist()
        views = []
        for swap, sign_x, sign_y in product((False, True), (1, -1), (1, -1)):
            source, sign = columns.clone(), th.ones(layout.local_size)
            source[x], source[y] = (y, x) if swap else (x, y)
            sign[x], sign[y] = float(sign_x), float(sign_y)
            # Move k seen from here is the move of the row whose step becomes the step of k.
            seen = [(sign_x * step[swap], sign_y * step[not swap]) for step in steps]
            move = th.tensor([seen.index((dx, dy)) for dx, dy in steps])  # (5,)
            for first in of_moves:  # of five columns
                source[first : first + MOVES] = first + move
            views.append((source, sign, move.argsort()))
        self.source, self.sign, self.move = (th.stack(part) for part in zip(*views, strict=True))

    def mean(self, network: Callable[[Tensor], Tensor], rows: Tensor) -> Tensor:
        """Return the network's outputs (B, 5 + ...) for ``rows`` (B, local), averaged; the first five are of moves."""
        source, sign, move = (part.to(rows.device) for part in (self.source, self.sign, self.move))
        means = []
        for part in th.split(rows, _ROWS):
            seen = (part[:, source] * sign).flatten(0, 1)  # (B * 8, local)
            outputs = network(seen).view(len(part), len(source), -1)  # (B, 8, 5 + ...)
            moves = outputs[..., :MOVES].gather(2, move.expand(len(part), -1, -1))
            means.append(th.cat([moves, outputs[..., MOVES:]], dim=2).mean(dim=1))
        return th.cat(means)
