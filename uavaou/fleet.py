"""The altitudes and CDSs of a fleet whose number of UAVs alone is changed."""

from collections.abc import Mapping
from typing import Any

_APART_M = 10.0  # where the given altitudes span no range
_LEAST_APART_M = 1e-3  # on average, for altitudes to be drawn from the range


def fit_fleet(fields: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Give ``fields`` an altitude and a CDS for each UAV if ``changes`` have ``uavs`` and not these.

    CDSs are repeated in their order. See :func:`spread_altitudes`.
    """
    uavs = changes.get("uavs")
    if not isinstance(uavs, int) or not 1 <= uavs <= 1000:  # refused, with what is allowed, when it is read
        return
    if "cds_m" not in changes and (given := fields.get("cds_m")):
        fields["cds_m"] = [given[u % len(given)] for u in range(uavs)]
    if "altitudes_m" not in changes and (given := fields.get("altitudes_m")):
        fields["altitudes_m"] = spread_altitudes(given, uavs)


def spread_altitudes(given: list[float], uavs: int) -> list[float]:
    """Return an altitude for each of ``uavs``: the first that are given, and then others of their range.

    The others halve the range, then the halves, and so on (van der Corput's sequence), without those that are taken.
    Where there is no range, they are 10 m apart, upwards.
    """
    altitudes, low, high = list(given[:uavs]), min(given), max(given)
    number, between = 0, high
    while len(altitudes) < uavs:
        number += 1
        if high - low > _LEAST_APART_M * uavs:
            part = int(f"{number:b}"[::-1], 2) / 2 ** number.bit_length()
            between = low + (high - low) * part
        else:
            between = high + _APART_M * number
        if between not in altitudes:
            altitudes.append(between)
    return altitudes
