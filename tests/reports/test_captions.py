"""What the page of results says below its figures of suites, from the tables of these."""

from __future__ import annotations

from statistics import fmean

from tests.committed import RESULTS, ends, rows

PAGE = (RESULTS / "README.md").read_text(encoding="utf-8")


def flown(suite: str, policy: str) -> dict[str, list[float]]:
    """Point -> the mean AoU in slots of each training of a policy there, or of the planner."""
    found: dict[str, list[float]] = {}
    for row in rows(f"suites/{suite}.csv"):
        if row["policy"] == policy:
            found.setdefault(row["point"], []).append(float(row["mean_aou_slots"]))
    return found


def averages(suite: str, policy: str) -> list[float]:
    """The mean over the seeds at each point."""
    return [fmean(means) for means in flown(suite, policy).values()]


def test_of_fading() -> None:
    planned, rule = (averages("fading", policy) for policy in ("best-first", "local-greedy-parts"))
    learned = {name: averages("fading", name) for name in ("mappo", "qmix", "ippo", "vdn")}
    pair = learned["mappo"] + learned["qmix"]
    assert planned == sorted(planned, reverse=True)
    assert f"`best-first` falls from {planned[0]:.0f} to {planned[-1]:.0f} slots." in PAGE
    assert f"stay between {min(pair):.0f} and {max(pair):.0f} (means of five seeds)" in PAGE
    assert f"as `local-greedy-parts` does between {min(rule):.0f} and {max(rule):.0f};" in PAGE
    above = zip(learned["ippo"], learned["vdn"], learned["mappo"], learned["qmix"], rule, strict=True)
    assert all(min(others[:2]) > max(others[2:]) for others in above)
    last = [learned["mappo"][-1], learned["qmix"][-1], rule[-1]]
    assert "ahead of all: MAPPO has {:.0f}, QMIX {:.0f}, the rule {:.0f} |".format(*last) in PAGE
    assert planned[-1] < min(last)
    assert {len(means) for name in learned for means in flown("fading", name).values()} == {5}


def test_of_rate() -> None:
    names, planners = ("mappo", "qmix", "ippo", "vdn"), ("greedy", "best-first", "local-greedy-parts")
    points = list(flown("rate", "mappo"))
    means = {name: dict(zip(points, averages("rate", name), strict=True)) for name in (*names, *planners)}
    at = {name: f"{one['160']:.0f}" for name, one in means.items()}
    learned = f"QMIX is at {at['qmix']} slots, MAPPO at {at['mappo']}, `best-first` at {at['best-first']} and "
    assert f"at 160 kbit/s {learned}`local-greedy-parts` at {at['local-greedy-parts']}." in PAGE
    above = [p for p in points if min(means[n][p] for n in names) > max(means[n][p] for n in planners)]
    assert "At 120 and from 170 on, all learners are above all planners (means of five seeds);" in PAGE
    assert above == ["120", "170", "180", "200"]
    seeds = flown("rate", "mappo")["120"] + flown("rate", "qmix")["120"]
    assert f"at 120 the seeds of MAPPO and QMIX have {min(seeds):.0f} to {max(seeds):.0f} slots." in PAGE
    assert "below each learner at every point but 150, where they were trained and QMIX is ahead of it |" in PAGE
    rule = means["local-greedy-parts"]
    ahead = [(name, p) for name in names for p in points if means[name][p] < rule[p]]
    assert ahead == [("qmix", "150")]


def test_of_layouts() -> None:
    trained = [mean for name in ("mappo", "qmix") for means in flown("layouts", name).values() for mean in means]
    assert f"fail on others, with {min(trained):,.0f} slots and more; `any-map` and" in PAGE
    assert len(trained) == 100
    planned = flown("layouts", "greedy")
    assert all(flown("layouts", "local-greedy-parts")[point] < planned[point] for point in planned)


def test_they_are_trainings_of_the_study() -> None:
    """The suites' trainings at the point that they were trained for, and those of the study of the paper."""
    for suite, point in (("fading", "10"), ("rate", "150")):
        for name in ("qmix", "vdn"):
            assert flown(suite, name)[point] == [round(mean, 4) for mean in ends("paper", name)[:5]]


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
