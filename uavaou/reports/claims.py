"""The paper's claims, and ours, judged by the flights of a study: verdicts are computed.

On a **direction** (fewer, lower, more): supported where the whole 95 % interval lies on the claimed side; contradicted
where it lies on the other side; partly supported where the estimate alone lies on the claimed side; otherwise not
supported. On a **size** (reduced to a share s): supported where the whole interval is at or below s; partly supported
where the estimate alone is, or where there is a reduction, the whole interval below 1, that does not reach s;
contradicted where the whole interval is above s and there is no such reduction; otherwise not supported. One training
of an algorithm has no interval: it supports a claim partly at best, and contradicts none. An estimate that nobody made
a claim about is **a figure**.

A run's validation AoU is smoothed by the mean of ``SMOOTHED`` evaluations, the present one and those before it. The
run **has converged** at the first evaluation from which on every smoothed value stays within ``WITHIN`` of the run's
lowest smoothed value. It **reaches** a level at the first evaluation whose smoothed value is at or below it. A run that
does neither counts with its whole budget. That flatters MAPPO, whose claim is then weakened, and not the others.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.stats import rankdata

from uavaou.arrays import Floats
from uavaou.evaluation.flights import DEVICES, TRAINING, VALIDATION
from uavaou.experiments.results import Curve, StudyResults
from uavaou.experiments.study import JUDGED
from uavaou.planners import PLANNERS, PLANNERS_WITH_PLAN
from uavaou.reports.markdown import rounded
from uavaou.reports.scores import best_planner
from uavaou.statistics import Interval, mean_of_tasks, ratio_of_trainings
from uavaou.world.knowledge import Knowledge

Trainings = Mapping[str, Floats]  # scenario -> (S,), one value a training; () for an untrained policy
Verdict = Literal["supported", "partly supported", "not supported", "contradicted", "not measured", "a figure"]
Decide = Callable[[Interval], Verdict]

OWN, *BASELINES = JUDGED
SMOOTHED = 3  # evaluations
WITHIN = 0.10
LAST_PART = 0.1  # of a training, whose reward is what it ends with

FEWER_ITERATIONS = "requires fewer iterations to achieve convergence compared to conventional Value-based RL algorithms"
HIGHER_REWARDS = "MAPPO-AoU converges faster and achieves higher rewards than the benchmarks"
LOWEST = "the minimum value of AoU is achieved through MAPPO-AoU"
REDUCED = "Compared to VDN and QMIX, the AoU during the execution is reduced by a factor of 1/2 and 2/3 respectively"
HALVED = "reduces the global AoU by at least a factor of 1/2 compared to conventional off-policy [...] approaches"
MORE_DEVICES = "find the most effective strategy for visiting more IoT devices"
FREQUENT = "devices with high generation frequencies result in a higher number of communications with UAVs"
_REDUCTIONS = (
    ("vdn", 1 / 2, "AoU in execution is reduced by 1/2 against VDN", REDUCED),
    ("qmix", 1 / 3, "AoU in execution is reduced by 2/3 against QMIX, read as: 1/3 is left", REDUCED),
    ("qmix", 2 / 3, "AoU in execution is reduced by 2/3 against QMIX, read as: 2/3 is left", REDUCED),
    ("qmix", 1 / 2, "AoU in execution is at least halved against QMIX", HALVED),
)
_AT_RANDOM = "random"  # the planner that serves devices without any preference
_COUNTS = (  # column, claim, what is counted, digits of the means
    ("communications", "MAPPO makes more communications than", "communications", 5),
    ("devices_served", "MAPPO serves more devices at least once than", "devices served at least once", 3),
)


@dataclass(frozen=True)
class Claim:
    """One claim and what a study says about it."""

    claim: str
    quote: str  # the paper's words; empty for a claim of this project
    verdict: Verdict
    measured: str  # what was measured, with its means
    estimate: Interval | None = None  # what the verdict rests on; None where it has not been measured
    command: str = ""  # that made the study


def judge(study: StudyResults) -> list[Claim]:
    """Every claim: on training first, then on execution, then ours; those without data are ``not measured``.

    The variants ``mappo``, ``vdn`` and ``qmix`` of the study are compared, in the scenarios that both have.
    """
    rules, searched = PLANNERS.keys() - PLANNERS_WITH_PLAN, PLANNERS_WITH_PLAN
    ours, judged = "MAPPO flies fresher than the best", _Judge(study)
    before = "rule that knows as much and was searched for this layout before take-off"
    claims = [
        *map(judged.convergence, BASELINES),
        *map(judged.time_to_level, BASELINES),
        *map(judged.last_reward, BASELINES),
        *(judged.aou(name, f"MAPPO's AoU in execution is lower than {name.upper()}'s", LOWEST) for name in BASELINES),
        *(judged.aou(name, text, quote, reduced_to(share)) for name, share, text, quote in _REDUCTIONS),
        *(judged.more(other, *counted) for counted in _COUNTS for other in BASELINES),
        judged.communications_by_frequency(),
        judged.served_by_frequency(),
        judged.beside_planner("everything", f"{ours} planner that knows everything", PLANNERS),
        judged.beside_planner("local", f"{ours} rule that knows as much and learns nothing", rules),
        judged.beside_planner("local", f"{ours} {before}", searched),
        judged.beside_bound(),
    ]
    return [replace(claim, command=f"uavaou study run {study.argument}") for claim in claims]


# -- verdicts ------------------------------------------------------------------------------------------


def lower(estimate: Interval, threshold: float = 1) -> Verdict:
    """The verdict on a claim that something is below the threshold."""
    if estimate.high < threshold:  # nan, an unknown interval, supports nothing
        return "supported"
    if estimate.low > threshold:
        return "contradicted"
    return "partly supported" if estimate.value < threshold else "not supported"


def higher(estimate: Interval) -> Verdict:
    """The verdict on a claim that a ratio is above 1."""
    return lower(Interval(-estimate.value, -estimate.high, -estimate.low), -1)


def reduced_to(share: float) -> Decide:
    """The verdict on a claim that a ratio is at most ``share``, a number below 1."""

    def decide(ratio: Interval) -> Verdict:
        if ratio.high <= share:
            return "supported"
        if ratio.value <= share or ratio.high < 1:
            return "partly supported"
        return "contradicted" if ratio.low > share else "not supported"

    return decide


def _ratio(claim: str, quote: str, values: Sequence[Trainings], decide: Decide, measured: str, missing: str) -> Claim:
    """A claim on the ratio of MAPPO's values to others', or that the study has nothing to judge it by.

    Args:
        claim, quote: as :class:`Claim` has them.
        values: MAPPO's and the others'; a ratio needs all of them above 0.
        decide: the verdict on the ratio.
        measured: the words that say what was measured.
        missing: what the study lacks where there are no such values.
    """
    if not all(own and min(group.min() for group in own.values()) > 0 for own in values):
        return _not_measured(claim, quote, missing)
    ratio = ratio_of_trainings(*values)
    return Claim(claim, quote, decide(ratio), measured, ratio)


def _not_measured(claim: str, quote: str, missing: str) -> Claim:
    return Claim(claim, quote, "not measured", f"the study has no {missing}")


def _mean(values: Trainings) -> float:
    """The mean over scenarios of the mean over trainings; nan of none."""
    return float(np.mean([group.mean() for group in values.values()])) if values else np.nan


def _means(values: Sequence[Trainings], name: str, unit: str = " slots", digits: int = 4, sign: int = 1) -> str:
    ours, theirs = (f"{rounded(sign * _mean(own), digits)}{unit}" for own in values)
    return f"MAPPO {ours}, {name} {theirs}"


# -- on training ---------------------------------------------------------------------------------------


class Moment(NamedTuple):
    """An evaluation of a training."""

    place: int  # among the evaluations, from 0
    happened: bool  # False: never, and the place is the last evaluation's


def smooth(aou: Floats) -> Floats:
    """The mean of each value and the ``SMOOTHED - 1`` before it, as far as there are that many, (E,)."""
    total = np.concatenate([[0.0], np.cumsum(aou)])  # (E + 1,)
    end = np.arange(1, len(aou) + 1)
    start = np.maximum(end - SMOOTHED, 0)
    return np.asarray((total[end] - total[start]) / (end - start))


def converged(aou: Floats) -> Moment:
    """When a training with the validation AoU (E,) has converged."""
    smoothed = smooth(aou)
    outside = np.flatnonzero(smoothed > (1 + WITHIN) * smoothed.min())
    first = int(outside[-1]) + 1 if len(outside) else 0
    return Moment(min(first, len(aou) - 1), first < len(aou))


def reached(aou: Floats, level: float) -> Moment:
    """When a training with the validation AoU (E,) reaches a level."""
    below = np.flatnonzero(smooth(aou) <= level)
    return Moment(int(below[0]), True) if len(below) else Moment(len(aou) - 1, False)


def _late(run: Curve) -> float:
    return float(run["mean_aou_slots"][run["x"] > (1 - LAST_PART) * run["x"][-1]].mean())


def _told(found: dict[str, list[Floats]], row: int) -> str:
    """A row of the correlations of MAPPO, and of random moves where they are there, in words."""
    named = zip(("MAPPO", f"`{_AT_RANDOM}`"), zip(*found.values(), strict=True), strict=False)
    return ", ".join(f"{name} {rounded(float(np.mean([one[row].mean() for one in values])))}" for name, values in named)


def _spearman(x: Floats, y: Floats) -> float:
    """The rank correlation of (n,) and (n,); nan where one of them is constant."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])


@dataclass(frozen=True)
class _Judge:
    """Judges single claims by a study."""

    study: StudyResults

    def _curves(self, curve: str, *variants: str) -> dict[str, list[list[Curve]]]:
        """Scenario -> the curves of each of the variants, where all of them have some."""
        names = self.study.scenarios
        found = {name: [self.study.curves(curve, variant, name) for variant in variants] for name in names}
        return {name: each for name, each in found.items() if all(each)}

    def _of_missions(self, variants: Sequence[str], column: str = "mean_aou_slots") -> list[dict[str, Floats]]:
        """The mean over the missions of each training, scenario -> (S,); of a planner, which is not trained, ().

        Of each variant, in the scenarios that all have flown.
        """
        flown = [self.study.missions(name, column) for name in variants]
        axes = [1 if name in self.study.algorithms else None for name in variants]
        common = [name for name in self.study.scenarios if all(name in tables for tables in flown)]
        return [
            {name: np.asarray(tables[name].mean(axis=axis)) for name in common}
            for tables, axis in zip(flown, axes, strict=True)
        ]

    # -- on training -----------------------------------------------------------------------------------

    def convergence(self, other: str) -> Claim:
        """Training slots until convergence."""
        text = f"MAPPO converges in fewer training slots than {other.upper()}"
        return self._sooner(other, text, "slots until convergence", "not converged", lambda _, aou: converged(aou))

    def time_to_level(self, other: str) -> Claim:
        """Training slots until a level that the other's trainings reach on average: one lucky training sets none."""
        text = f"MAPPO reaches the level of {other.upper()}'s trainings sooner than these do"
        levels = {
            name: (1 + WITHIN) * float(np.mean([smooth(run["mean_aou_slots"]).min() for run in theirs]))
            for name, (_, theirs) in self._curves(VALIDATION, OWN, other).items()
        }
        told = "".join(f" ({rounded(level)} slots)" for level in levels.values() if len(levels) == 1)
        what = f"training slots until that AoU{told}"
        return self._sooner(other, text, what, "never", lambda name, aou: reached(aou, levels[name]))

    def _sooner(self, other: str, text: str, what: str, missed: str, when: Callable[[str, Floats], Moment]) -> Claim:
        """A claim on fewer slots, weakened where trainings never come to the moment and count with their budget."""
        curves, slots, never, told = self._curves(VALIDATION, OWN, other), [], [], []
        for side, variant in enumerate((OWN, other)):
            runs = {
                name: [(run, when(name, run["mean_aou_slots"])) for run in pair[side]] for name, pair in curves.items()
            }
            slots.append({name: np.array([run["x"][at.place] for run, at in own]) for name, own in runs.items()})
            happened = [at.happened for own in runs.values() for _, at in own]
            never.append(happened.count(False))
            budget = f" ({never[side]} of {len(happened)} trainings {missed}: the budget counts)" if never[side] else ""
            told.append(f"{variant.upper()} {_mean(slots[side]):,.0f} slots{budget}")

        def decide(ratio: Interval) -> Verdict:
            verdict = lower(ratio)
            if never[0] and verdict == "supported":
                verdict = "partly supported"
            if never[0] == sum(map(len, slots[0].values())) and verdict == "partly supported":
                verdict = "not supported"
            # Those of the other that never come to it would take longer than their budget: they contradict nothing.
            return "not supported" if verdict == "contradicted" and never[1] else verdict

        missing = f"validation of both '{OWN}' and '{other}'"
        return _ratio(text, FEWER_ITERATIONS, slots, decide, f"{what}: {', '.join(told)}; ratio", missing)

    def last_reward(self, other: str) -> Claim:
        """The reward of the training missions at the end of training; rewards are negative: smaller is more."""
        text, runs = f"MAPPO ends training with higher rewards than {other.upper()}", self._curves(TRAINING, OWN, other)
        sizes = [
            {name: np.array(list(map(_late, pair[side]))) * self.study.mission_s(name) for name, pair in runs.items()}
            for side in (0, 1)
        ]
        told = _means(sizes, other.upper(), " s", sign=-1)
        measured = f"reward of the training missions in the last {LAST_PART:.0%} of training: {told}; ratio of sizes"
        return _ratio(text, HIGHER_REWARDS, sizes, lower, measured, f"rewards below 0 of both '{OWN}' and '{other}'")

    # -- on execution ----------------------------------------------------------------------------------

    def aou(self, other: str, text: str, quote: str, decide: Decide = lower) -> Claim:
        """AoU in execution; the reward of a mission is that times a negative constant."""
        values, name = self._of_missions((OWN, other)), other.upper() if other in BASELINES else f"`{other}`"
        missing = f"missions of both '{OWN}' and '{other}' with an AoU above 0"
        return _ratio(text, quote, values, decide, f"mean AoU {_means(values, name)}; ratio", missing)

    def more(self, other: str, column: str, text: str, what: str, digits: int) -> Claim:
        """A count of a mission that MAPPO has more of."""
        values = self._of_missions((OWN, other), column)
        measured = f"{what} a mission: {_means(values, other.upper(), '', digits)}; ratio"
        missing = f"missions of both '{OWN}' and '{other}' with {what}"
        return _ratio(f"{text} {other.upper()}", MORE_DEVICES, values, higher, measured, missing)

    def communications_by_frequency(self) -> Claim:
        """The paper's sentence as it is written: communications fall with the generation period k."""
        text = "devices that generate more often have more communications with MAPPO"
        found = self._correlations(OWN, _AT_RANDOM) or self._correlations(OWN)
        if not found:
            return _not_measured(text, FREQUENT, f"devices of '{OWN}' with different periods and communications")
        estimate = mean_of_tasks({name: own[0] for name, (own, *_) in found.items()}).within(-1, 1)
        measured = (
            f"Spearman correlation over devices of communications with the generation period k: {_told(found, 0)}"
        )
        return Claim(text, FREQUENT, lower(estimate, 0), measured, estimate)

    def served_by_frequency(self) -> Claim:
        """A communication needs a pending update, so that a device has at most K/k of them in a mission.

        Every policy measured has fewer communications with a longer k, moves at random included. What MAPPO adds to
        them is the correlation of the share of the cap, less that of moves at random.
        """
        text = (
            "MAPPO serves devices more often that generate more often, beyond what their updates allow at random moves"
        )
        found = self._correlations(OWN, _AT_RANDOM)
        if not found:
            missing = f"devices of both '{OWN}' and '{_AT_RANDOM}' with different periods and communications"
            return _not_measured(text, "", missing)
        measured = (
            f"Spearman correlation over devices with the generation period k, of communications: {_told(found, 0)}; of "
            f"their share of K/k: {_told(found, 1)}; difference of the latter"
        )
        difference = mean_of_tasks({name: own[1] - random[1] for name, (own, random) in found.items()}).within(-2, 2)
        return Claim(text, "", lower(difference, 0), measured, difference)

    def _correlations(self, *variants: str) -> dict[str, list[Floats]]:
        """Correlations with k of communications, and of their share of K/k: scenario -> (2, S) of each variant."""
        found: dict[str, list[Floats]] = {}
        for scenario, pair in self._curves(DEVICES, *variants).items():
            k = self.study.periods(scenario)  # (I,)
            counts = [[run["communications"] for run in each] for each in pair]
            values = [np.array([[_spearman(one, k), _spearman(one * k, k)] for one in each]).T for each in counts]
            if all(np.isfinite(value).all() for value in values):
                found[scenario] = values
        return found

    # -- ours ------------------------------------------------------------------------------------------

    def beside_planner(self, knows: Knowledge, text: str, among: Collection[str]) -> Claim:
        """AoU beside the best planner of those that know so much."""
        planner = best_planner(self.study, list(self.study.missions(OWN)), knows, among)
        if planner is None:
            return _not_measured(text, "", f"missions of both '{OWN}' and such a planner that knows: {knows}")
        return self.aou(planner, text, "")

    def beside_bound(self) -> Claim:
        """No claim: no policy is below the bound in expectation and without foreseeing the channel.

        :func:`uavaou.reports.scores.below_bound` reports one that is.
        """
        (flown,) = self._of_missions((OWN,))
        bound = {name: np.array(self.study.bounds[name]) for name in flown if self.study.bounds.get(name, 0) > 0}
        values = [{name: flown[name] for name in bound}, bound]
        text, missing = "how far MAPPO is from the certified lower bound", f"missions of '{OWN}' beside a bound above 0"
        return _ratio(text, "", values, lambda _: "a figure", f"mean AoU {_means(values, 'bound')}; ratio", missing)
