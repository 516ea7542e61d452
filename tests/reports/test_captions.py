"""What the page of results says below its figures of suites, from the tables of these."""

from __future__ import annotations

from tests.committed import RESULTS, rows

PAGE = (RESULTS / "README.md").read_text(encoding="utf-8")


def flown(suite: str, policy: str) -> dict[str, list[float]]:
    """Point -> the mean AoU in slots of each training of a policy there, or of the planner."""
    found: dict[str, list[float]] = {}
    for row in rows(f"suites/{suite}.csv"):
        if row["policy"] == policy:
            found.setdefault(row["point"], []).append(float(row["mean_aou_slots"]))
    return found


def test_of_uavs() -> None:
    ours, planned, rule = (flown("uavs", policy) for policy in ("mappo", "best-first", "local-greedy-parts"))
    assert f"from 3 to 4 UAVs, MAPPO's mean AoU falls from {ours['3'][0]:.1f} to {ours['4'][0]:.1f} slots" in PAGE
    assert "(seed 0 of each). It is below `best-first` at every point, and with 3 and 5 UAVs above `local-g" in PAGE
    assert ours.keys() == planned.keys()
    assert all(ours[point][0] < planned[point][0] for point in ours)
    assert [point for point in ours if ours[point][0] > rule[point][0]] == ["3", "5"]


def test_of_devices() -> None:
    assert "MAPPO is below `best-first` up to 100 devices, and above `greedy` at 200. From 25 devices on it" in PAGE
    ours, *planners = (flown("devices", one) for one in ("mappo", "best-first", "greedy", "local-greedy-parts"))
    planned, greedy, rule = planners
    assert {point for point in ours if ours[point][0] < planned[point][0]} == ours.keys() - {"200"}
    assert ours["200"][0] > greedy["200"][0]
    assert [point for point in ours if ours[point][0] > rule[point][0]] == ["25", "50", "75", "100", "200"]


def test_of_observation() -> None:
    assert "observation, 1M slots, ten seeds:" in PAGE
    assert {point: len(means) for point, means in flown("observation", "mappo").items()} == dict.fromkeys(
        ("location", "local", "shared"), 10
    )
