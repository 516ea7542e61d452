"""Verdicts come out each way on studies whose truth is known."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import gmean, spearmanr, ttest_1samp

from tests.synthetic_study import (
    BUDGET,
    DEFAULT,
    MAPPO,
    PERIODS,
    PLANNERS,
    QMIX,
    VDN,
    K,
    Variant,
    edit,
    without,
    write_study,
)
from uavaou import InputError, read_study
from uavaou.evaluation.flights import DEVICES, TRAINING, VALIDATION, Flights
from uavaou.reports.claims import Claim, Decide, converged, higher, judge, lower, reached, reduced_to
from uavaou.statistics import Interval, ratio_of_trainings

MANY = 9  # seeds
# At random, the share of the cap falls less with k than MAPPO's; two rules know as much as MAPPO, one of them tuned.
RULES = {"local-greedy": Variant(70.0), "local-greedy-tuned": Variant(65.0)}
RIVALS = PLANNERS | RULES | {"random": Variant(5000.0, by_period=0.0)}


def verdicts(folder: Path, **changes: object) -> list[Claim]:
    """The claims of a study with some variants changed: ``mappo=replace(MAPPO, aou=30)``; planners and bound too."""
    options = {"planners": RIVALS} | {
        name: changes.pop(name) for name in ("planners", "bound", "seeds", "scenarios") if name in changes
    }
    variants = {name: variant for name, variant in (DEFAULT | changes).items() if variant is not None}
    return judge(read_study(write_study(folder, variants, **options)))  # type: ignore[arg-type]


def of(claims: list[Claim], *words: str) -> Claim:
    found = [claim for claim in claims if all(word in claim.claim for word in words)]
    assert len(found) == 1, [claim.claim for claim in found]
    return found[0]


def test_every_claim_is_supported_where_it_is_true(tmp_path: Path) -> None:
    claims = verdicts(tmp_path / "true")
    assert len(claims) == 22
    assert {claim.verdict for claim in claims[:-1]} == {"supported"}
    assert claims[-1].verdict == "a figure"  # the bound lies below everyone: that is no claim
    assert all(claim.command == "uavaou study run true.yaml" for claim in claims)
    reduced = of(claims, "reduced by 1/2")
    assert reduced.estimate is not None
    assert reduced.estimate.value == pytest.approx(0.4, rel=0.05)
    assert reduced.estimate.low < reduced.estimate.value < reduced.estimate.high


def test_every_claim_of_the_paper_fails_where_it_is_false(tmp_path: Path) -> None:
    worse = Variant(200.0, converges=58_000, communications=200.0, served=5.0, by_period=+10.0)
    claims = verdicts(tmp_path / "false", mappo=worse)
    assert {claim.verdict for claim in claims[:-1] if "beyond" not in claim.claim} == {"contradicted"}
    assert of(claims, "beyond what their updates").verdict == "not supported"  # random moves are no better
    assert claims[-1].verdict == "a figure"


def test_how_far_the_bound_is_has_an_interval_over_seeds(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", bound=20.0)
    claim = of(judge(read_study(folder)), "lower bound")
    means = read_study(folder).stack("mappo", "paper").mean(axis=1)
    assert claim.estimate == ratio_of_trainings({"": means}, {"": 20.0})
    assert claim.estimate.low < 2 < claim.estimate.high


# Each claim between yes and no: the estimate lies on the claimed side, the interval reaches the other.
HALF: list[tuple[dict[str, object], tuple[str, ...]]] = [
    ({"vdn": replace(VDN, aou=60.0)}, ("reduced by 1/2",)),
    ({"vdn": replace(VDN, aou=110.0, spread=0.3)}, ("reduced by 1/2",)),
    ({"qmix": replace(QMIX, aou=80.0)}, ("reduced by 2/3", "1/3 is left")),
    ({"qmix": replace(QMIX, aou=50.0)}, ("reduced by 2/3", "2/3 is left")),
    ({"planners": {"greedy": Variant(42.0)}, "mappo": replace(MAPPO, spread=0.2)}, ("knows everything",)),
]


@pytest.mark.parametrize(("changes", "words"), HALF, ids=range(len(HALF)))
def test_claims_are_partly_supported(tmp_path: Path, changes: dict[str, object], words: tuple[str, ...]) -> None:
    claim = of(verdicts(tmp_path / "study", **changes), *words)
    assert claim.verdict == "partly supported", claim


@pytest.mark.parametrize(
    ("missing", "unmeasured"),
    [({"vdn": None}, 7), ({"vdn": None, "qmix": None}, 16), ({"mappo": None}, 22), ({"bound": None}, 1)],
)
def test_what_is_missing_is_not_measured(tmp_path: Path, missing: dict[str, object], unmeasured: int) -> None:
    claims = verdicts(tmp_path / "study", **missing)
    without = [claim for claim in claims if claim.verdict == "not measured"]
    assert len(without) == unmeasured
    assert all(claim.estimate is None and "the study has no" in claim.measured for claim in without)


def test_one_seed_supports_no_claim(tmp_path: Path) -> None:
    """Missions of one training say nothing of another: whatever there are of them, there is no interval."""
    claims = verdicts(tmp_path / "study", seeds=1)
    assert {claim.verdict for claim in claims[:-1]} == {"partly supported"}
    for claim in claims:
        assert claim.estimate is not None
        assert np.isnan([claim.estimate.low, claim.estimate.high]).all()


def test_one_training_of_the_other_supports_no_claim(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    for seed in (1, 2, 3):
        without(folder, policy="vdn", seed=seed)
    claims = judge(read_study(folder))
    against = [claim for claim in claims if "VDN" in claim.claim]
    assert len(against) == 7
    assert {claim.verdict for claim in against} == {"partly supported"}
    assert of(claims, "reduced by 2/3", "1/3 is left").verdict == "supported"


def test_the_planner_beside_mappo_is_the_best_of_those_that_know_so_much(tmp_path: Path) -> None:
    planners = RIVALS | {"random": Variant(1.0), "anneal": Variant(2.0)}  # both look at nothing in flight
    claims = verdicts(tmp_path / "study", planners=planners)
    for words, rival in (
        ("knows everything", "`best-first`"),
        ("learns nothing", "`local-greedy`"),
        ("searched for this layout", "`local-greedy-tuned`"),
    ):
        claim = of(claims, words)
        assert rival in claim.measured
        assert claim.verdict == "supported"


@pytest.mark.parametrize(
    ("words", "of_cap", "against"),
    [("have more communications", False, None), ("beyond what their updates", True, "random")],
)
def test_correlations_are_spearmans(tmp_path: Path, words: str, of_cap: bool, against: str | None) -> None:
    folder = write_study(tmp_path / "study", {"mappo": replace(MAPPO, by_period=-9.0, spread=0.3)}, seeds=3)
    results = read_study(folder)
    claim = of(judge(results), words)

    def literal(variant: str | None, seed: int) -> float:
        if variant is None:
            return 0.0
        counts = results.curves(DEVICES, variant, "paper")[seed]["communications"]
        return float(spearmanr(counts / (K / PERIODS if of_cap else 1.0), PERIODS).statistic)

    values = [literal("mappo", seed) - literal(against, 0) for seed in range(3)]
    assert claim.estimate is not None
    assert claim.estimate.value == pytest.approx(np.mean(values))
    interval = ttest_1samp(values, 0).confidence_interval(0.95)
    assert claim.estimate[1:] == pytest.approx((max(interval.low, -1 - bool(against)), interval.high))


def test_random_moves_are_told_beside_the_sentence_on_periods_where_they_were_flown(tmp_path: Path) -> None:
    claim = of(verdicts(tmp_path / "study", planners={"greedy": Variant(80.0)}), "have more communications")
    assert claim.verdict == "supported"
    assert "random" not in claim.measured


def test_that_updates_cap_communications_supports_nothing(tmp_path: Path) -> None:
    """MAPPO and random moves fill the same share of each cap: fewer communications with a long k are no merit."""
    folder = write_study(tmp_path / "study", seeds=3)

    def capped(table: Flights) -> Flights:
        curves = table.curves.copy()
        of_devices = curves["curve"] == DEVICES
        device = curves.loc[of_devices, "x"].astype(int)
        share = np.where(curves.loc[of_devices, "policy"] == "random", 0.9, 0.5) + 0.01 * np.sin(device)
        curves.loc[of_devices, "communications"] = K / PERIODS[device] * share
        return Flights(table.flights, curves)

    edit(folder, capped)
    claims = judge(read_study(folder))
    claim = of(claims, "beyond what their updates")
    assert (claim.verdict, "of communications: MAPPO -0.9" in claim.measured) == ("not supported", True)
    written = of(claims, "have more communications")
    assert (written.verdict, "`random` -0.9" in written.measured) == ("supported", True)


@pytest.mark.parametrize(
    ("estimate", "decide", "expected"),
    [
        (Interval(0.8, 0.7, 0.9), lower, "supported"),
        (Interval(0.8, 0.7, 1.1), lower, "partly supported"),
        (Interval(1.2, 0.9, 1.5), lower, "not supported"),
        (Interval(1.2, 1.1, 1.3), lower, "contradicted"),
        (Interval(1.2, np.nan, np.nan), lower, "not supported"),
        (Interval(0.8, 0.7, 0.9), higher, "contradicted"),
        (Interval(1.0, 1.0, 1.0), lower, "not supported"),
        (Interval(0.8, np.nan, np.nan), lower, "partly supported"),
        (Interval(1.2, 1.1, 1.3), higher, "supported"),
        (Interval(1.2, 0.9, 1.3), higher, "partly supported"),
        (Interval(1.0, 1.0, 1.0), higher, "not supported"),
    ],
)
def test_direction(estimate: Interval, decide: Decide, expected: str) -> None:
    assert decide(estimate) == expected


@pytest.mark.parametrize(
    ("estimate", "expected"),
    [
        (Interval(0.4, 0.3, 0.45), "supported"),
        (Interval(0.5, 0.5, 0.5), "supported"),
        (Interval(0.52, 0.48, 0.56), "partly supported"),
        (Interval(0.6, 0.55, 0.65), "partly supported"),
        (Interval(0.75, 0.45, 0.99), "partly supported"),  # a wide interval supports no more than a narrow one
        (Interval(0.5, 0.2, 1.2), "partly supported"),
        (Interval(0.75, 0.45, 1.01), "not supported"),
        (Interval(0.75, 0.55, 1.01), "contradicted"),
        (Interval(1.5, 1.4, 1.6), "contradicted"),
        (Interval(0.4, np.nan, np.nan), "partly supported"),
        (Interval(0.6, np.nan, np.nan), "not supported"),
    ],
)
def test_size(estimate: Interval, expected: str) -> None:
    assert reduced_to(0.5)(estimate) == expected


# -- convergence ---------------------------------------------------------------------------------------


def slow_converged(aou: list[float]) -> tuple[int, bool]:
    smoothed = [sum(aou[max(0, e - 2) : e + 1]) / len(aou[max(0, e - 2) : e + 1]) for e in range(len(aou))]
    for e in range(len(aou)):
        if all(value <= 1.1 * min(smoothed) for value in smoothed[e:]):
            return e, True
    return len(aou) - 1, False


@pytest.mark.parametrize("seed", range(20))
def test_convergence_is_the_first_evaluation_after_which_nothing_leaves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    aou = 50 * (1 + 9 * np.exp(-np.arange(25) / 4)) * rng.lognormal(0, 0.12, 25)
    assert converged(aou) == slow_converged(aou.tolist())


def test_levels_are_reached_and_trainings_converge_or_not() -> None:
    assert converged(np.array([9.0, 3.0, 3.0, 3.0, 9.0])) == (4, False)
    assert converged(np.array([5.0])) == (0, True)
    aou = np.array([9.0, 6.0, 3.0, 3.0, 3.0])
    assert reached(aou, 4.5) == (3, True)
    assert reached(aou, 2.9) == (4, False)


def validated_at(folder: Path, variant: str, curves: list[list[float]], times: list[list[int]]) -> None:
    """Replace a variant's validation by AoU at slots, a pair of lists for each seed."""
    without(folder, policy=variant, curve=VALIDATION)
    new = [
        Flights.of({"x": []}, [{"curve": VALIDATION, "x": slots, "mean_aou_slots": aou}]).with_values(
            policy=variant, scenario="paper", seed=seed
        )
        for seed, (aou, slots) in enumerate(zip(curves, times, strict=True))
    ]
    edit(folder, lambda table: Flights.joined([table, *new]))


def test_times_to_a_level_are_those_of_every_training(tmp_path: Path) -> None:
    """Best AoU of VDN 10 and 20: the level is 16.5, where its second training never gets; MAPPO's both do."""
    folder = write_study(tmp_path / "study", seeds=2)
    slots = [100, 200, 300, 400, 500]
    validated_at(folder, "vdn", [[90, 30, 10, 10, 10], [90, 20, 20, 20, 20]], [slots, [2 * at for at in slots]])
    validated_at(folder, "mappo", [[9, 9, 9, 9, 9], [90, 9, 9, 9, 9]], [slots, slots])
    claim = of(judge(read_study(folder)), "level of VDN")
    assert claim.estimate == ratio_of_trainings({"": [100, 400]}, {"": [500, 1000]})
    assert "(16.5 slots): MAPPO 250 slots, VDN 750 slots (1 of 2 trainings never: the budget counts)" in claim.measured
    assert claim.estimate is not None
    assert claim.estimate.low < 1 < claim.estimate.high
    assert claim.verdict == "partly supported"


def test_convergence_is_that_of_every_training(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study", seeds=2)
    slots = [100, 200, 300, 400, 500]
    validated_at(folder, "mappo", [[9, 9, 9, 9, 9], [90, 9, 9, 9, 9]], [slots, slots])
    validated_at(folder, "vdn", [[90, 9, 9, 9, 9], [9, 9, 9, 90, 90]], [slots, slots])
    claim = of(judge(read_study(folder)), "converges", "VDN")
    assert claim.estimate == ratio_of_trainings({"": [100, 400]}, {"": [400, 500]})
    assert "MAPPO 250 slots, VDN 450 slots (1 of 2 trainings not converged: the budget counts)" in claim.measured


def test_a_run_that_never_gets_there_supports_nothing(tmp_path: Path) -> None:
    """Its budget may end before the other's trainings get to the level: that is no sooner."""
    vdn = replace(VDN, spread=0.002)
    folder = write_study(tmp_path / "study", {"mappo": replace(MAPPO, aou=400.0), "vdn": vdn})
    late = "policy == 'mappo' and curve == 'validation' and x > 30000"
    edit(folder, lambda table: Flights(table.flights, table.curves.drop(index=table.curves.query(late).index)))
    claim = of(judge(read_study(folder)), "level of VDN")
    assert claim.estimate is not None
    assert claim.estimate.high < 1
    assert claim.verdict == "not supported"


def test_the_last_reward_is_that_of_the_last_tenth(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    claim = of(judge(read_study(folder)), "higher rewards", "VDN")
    late = {}
    for variant in ("mappo", "vdn"):
        runs = read_study(folder).curves(TRAINING, variant, "paper")
        assert all((run["x"] > 0.9 * BUDGET).sum() == 2 for run in runs)  # of 20 groups a seed
        late[variant] = [run["mean_aou_slots"][run["x"] > 0.9 * BUDGET].mean() for run in runs]
    assert claim.estimate is not None
    assert claim.estimate.value == pytest.approx(gmean(late["mappo"]) / gmean(late["vdn"]))
    assert claim.estimate.value < 1


def test_a_scenario_without_ages_is_not_compared(tmp_path: Path) -> None:
    """A ratio there would be none; the study's other figures stay."""
    folder = write_study(tmp_path / "study", scenarios=("paper", "still"), seeds=2, missions=3)

    def still(table: Flights) -> Flights:
        columns = ["mean_aou_slots", "communications", "devices_served"]
        table.flights.loc[table.flights["scenario"] == "still", columns] = 0.0
        return table

    edit(folder, still)
    claims = judge(read_study(folder))
    assert of(claims, "reduced by 1/2").verdict == "not measured"
    assert of(claims, "more communications", "VDN").verdict == "not measured"
    assert of(claims, "converges", "VDN").verdict == "supported"


Break = Callable[[Path], object]


def rename_scenario(folder: Path, name: str) -> None:
    edit(folder, lambda table: table.with_values(scenario=name))


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (lambda folder: (folder / "study.yaml").write_text("scenarios: [paper]"), "scenarios.paper.slots = None"),
        (lambda folder: (folder / "study.yaml").write_text("scenarios: {paper: {slots: 3}}"), "slot_length_s = None"),
        (lambda folder: (folder / "flights.csv.gz").write_text("x"), "flights.csv.gz"),
        (lambda folder: rename_scenario(folder, "../up"), "'../up' cannot name a folder"),
    ],
)
def test_a_damaged_study_is_an_input_error(tmp_path: Path, break_it: Break, words: str) -> None:
    folder = write_study(tmp_path / "study", seeds=1)
    break_it(folder)
    with pytest.raises(InputError, match=words):
        judge(read_study(folder))
