"""Who collects whom: constraints (Rate) and (Association) of the paper, held by construction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Association:
    """The outcome of one slot in N missions."""

    collected_by: NDArray[np.int64]  # (N, I), the u with alpha_iu = 1; -1 for none
    rejected_rate: NDArray[np.int64]  # (N,), selections below R_min
    rejected_association: NDArray[np.int64]  # (N,), selections that lost to a better rate


def associate(in_range: NDArray[np.bool_], snr: NDArray[np.float64], selected: NDArray[np.bool_] | None) -> Association:
    """Give each device to the candidate with the largest rate, the lowest u on a tie.

    A device's bandwidth is the same towards every UAV, so the largest SNR is the largest rate.

    Args:
        in_range: R_iu >= R_min, (N, U, I).
        snr: Gamma_iu, (N, U, I).
        selected: the devices that each UAV selected, (N, U, I); None selects every device in range.
    """
    missions, uavs, devices = in_range.shape
    candidates = in_range if selected is None else in_range & selected  # (N, U, I)
    collected_by = np.full((missions, devices), -1, dtype=np.int64)  # (N, I)
    best = np.full((missions, devices), -1.0)  # (N, I), SNRs are never negative
    for u in range(uavs):
        wins = candidates[:, u] & (snr[:, u] > best)  # strictly: a tie stays with the lower u
        collected_by[wins] = u
        np.copyto(best, snr[:, u], where=wins)
    offered = np.count_nonzero(candidates, axis=(1, 2))  # (N,)
    asked = offered if selected is None else np.count_nonzero(selected, axis=(1, 2))
    won = np.count_nonzero(collected_by >= 0, axis=1)
    return Association(collected_by, asked - offered, offered - won)
