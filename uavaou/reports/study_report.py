"""The report of a study: a page of tables beside its condensed results, and what other tools read.

``results/studies/<name>/README.md`` says what is not done yet, and holds the table of every scenario, the comparison
with the study's reference where it names one, and the verdicts on the paper's claims where it judges them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from uavaou.errors import InputError, command_line
from uavaou.evaluation.flights import VALIDATION, PartKey
from uavaou.experiments.marl_eval import to_marl_eval
from uavaou.experiments.results import StudyFolder, StudyResults, read_study
from uavaou.experiments.run import gather, read_state, update_results
from uavaou.experiments.study import Study
from uavaou.files import read_text, write_json, write_text
from uavaou.reports.ablations import Ablation, ablation_table, ablations
from uavaou.reports.claims import SMOOTHED, WITHIN, Claim, converged, judge, smooth
from uavaou.reports.markdown import BLOCK, END, begin, filled, rounded, table, with_interval
from uavaou.reports.replay.page import STUDY_REPLAY, write_study_replay
from uavaou.reports.scores import PolicyScores, below_bound, study_scores
from uavaou.reports.suite_tables import suites_markdown
from uavaou.reports.suites import suites_of_study
from uavaou.runs.lock import HeldError, one_writer
from uavaou.runs.names import uavaou_with

_NOTE = """\
AoU in slots: the mean over the slots of a mission, in units of the slot length τ. The missions are those of the final
evaluation, which no training and no choice of a checkpoint has seen. Mean AoU: the mean over seeds with Student's 95 %
interval over seeds; of one seed, and of planners, with a bootstrap interval over missions. IQM: the mean of the middle
half of all missions, with a stratified bootstrap over seeds and missions. Knows: what a policy reads in flight
(docs/reference/planners.md); a plan made before take-off may use the whole map."""
_BOUND_NOTE = " No policy has a mean AoU below the lower bound in expectation and without foreseeing the channel."
_COMMANDS = """\
```
{uavaou} study run {study}
{uavaou} study report {study}
uavaou plot figures results/studies/{name}
```"""
_REPLAY = f"[{STUDY_REPLAY}]({STUDY_REPLAY}) plays one mission of each kept policy, side by side, in a browser."
_HEAD = ("policy", "knows", "seeds", "mean AoU (slots)", "IQM (slots)", "wall-clock of a training", "violations")
_SEVERAL_PROCESSORS = """\
The trainings{where} ran on several processors, or it was not recorded on which: their wall-clock times do not compare
policies."""
_DIGITS = 4

_MOST_BYTES = 5_000_000

_RULES = f"""\
Verdicts are computed. On a direction: *supported* where the whole 95 % interval lies on the claimed side,
*contradicted* where it lies on the other side, *partly supported* where the estimate alone lies on the claimed side,
else *not supported*. On a reduction to a share: *supported* where the whole interval is at or below the share; *partly
supported* where the estimate alone is, or where there is a reduction (the whole interval is below 1) that does not
reach the share; *contradicted* where the whole interval is above the share without such a reduction; else *not
supported*. One training of an algorithm has no interval: it supports a claim partly at best and contradicts none. Where
some of MAPPO's trainings never converge or never reach the level, a claim about that is *partly supported* at best;
where none of them does, it is *not supported* or *contradicted*. *A figure* is an estimate that nobody made a claim
about.

Ratios are those of geometric means over trainings, with Welch's interval on the logarithms; against a planner or the
bound, which is one number, with Student's. A communication needs a waiting update, so that a device has at most K/k of
them; the correlation of their share of this cap is held against that of random moves, with Student's interval over
seeds. The sample is that of trainings: each counts with the mean of its missions. A training has converged at the first
evaluation from which on its validation AoU, averaged over {SMOOTHED} evaluations, stays within {WITHIN:.0%} of its own
best. The level of an algorithm's trainings is {WITHIN:.0%} above the mean of the best such AoU of each of them; a
training reaches it at its first evaluation at or below it. A training that never converges or never reaches the level
counts with its whole budget."""
_TRAININGS_HEAD = ("policy", "seed", "mean AoU (slots)", "level (slots)", "converged at")
_TRAININGS_NOTE = f"""\
Level: the lowest validation AoU of the training, averaged over {SMOOTHED} evaluations. Converged at: the training slots
from which on that average stays within {WITHIN:.0%} of the level."""
_CLAIMS_HEAD = ("claim", "the paper's words", "measured", "estimate", "95 % interval", "verdict")


def report_study(study: Study, out: Path, remark: Callable[[str], None], plugins: Sequence[str] = ()) -> None:
    """Bring the condensed results of a study up to date, and write its page.

    While the study runs, its tables are taken as they stand.

    Args:
        study: what is reported.
        out: the folder of all results.
        remark: called with each line that the user should know.
        plugins: that its commands need.

    Raises:
        InputError: nothing has been evaluated, the results are another study's or damaged, or a file cannot be written.
    """
    folder = StudyFolder.of(out, study.name)
    results, problems = gather(study, out)
    if not len(results.flights):  # nothing is written before this is known
        _tell(problems, remark)
        raise InputError(f"nothing of study '{study.name}' has been evaluated below '{out}' yet: run it first")
    with ExitStack() as stack:
        try:
            stack.enter_context(one_writer(folder.path))
        except HeldError as held:  # by the study itself, which keeps the tables up to date
            remark(f"{held.by} is at work on the study: its page is written from the tables as they stand")
        else:
            from uavaou.experiments.best import record_missions  # imports torch

            results, problems = update_results(study, out)
            _tell(problems, remark)
            record_missions(folder.path)
            write_study_replay(folder.path, results.algorithms)
        for line in write_report(folder.path, out / "README.md", plugins):
            remark(line)


def _tell(problems: Mapping[PartKey, str], remark: Callable[[str], None]) -> None:
    for key, reason in problems.items():
        remark(f"left out: {key}: {reason}")


def write_report(folder: Path, results_page: Path, plugins: Sequence[str] = ()) -> list[str]:
    """Write ``README.md`` and ``marl-eval.json`` in a study's folder.

    Args:
        folder: ``results/studies/<name>``.
        results_page: gets the verdicts between its markers, where the study judges the paper's claims.
        plugins: that its commands need.

    Returns:
        Lines that the user should know: a policy below the bound, a page that belongs to another study.

    Raises:
        InputError: the condensed results are missing or damaged, or a file cannot be written.
    """
    results = read_study(folder).require_evaluated()
    remarks = below_bound(results)
    parts = [
        f"# Study `{results.name}`",
        str(results.settings.get("description", "")),
        _REPLAY if (folder / STUDY_REPLAY).exists() else "",
        _COMMANDS.format(uavaou=command_line(uavaou_with(plugins)), study=results.argument, name=results.name),
        _unfinished(results),
        *(f"**Something is wrong: {line}.**" for line in remarks),
        *(_results(results) if results.scenarios else ()),
        *suites_markdown(suites_of_study(results)),
        *_trainings(results),
        *_comparison(results),
    ]
    claims = judge(results) if results.settings.get("claims") else None
    if claims is not None:
        parts += ["## The paper's claims", claims_markdown(claims)]
    write_text(folder / "README.md", "\n\n".join(part for part in parts if part) + "\n")
    if results.algorithms:
        write_json(folder / "marl-eval.json", to_marl_eval(results))
    if claims is None:
        return remarks
    held = write_claims(results_page, results.name, claims)
    if held != results.name:
        remarks.append(f"{results_page}: left as it is: the claims there are judged from study '{held}'")
    return remarks


def _unfinished(results: StudyResults) -> str:
    """How many trainings there are of how many, where some are missing, and which parts have failed."""
    settings = results.settings
    own = settings.get("own_seeds", {})
    wanted = {
        PartKey(policy, scenario, seed)
        for policy, scenario in product(settings.get("variants", ()), settings.get("scenarios", ()))
        for seed in own.get(scenario, settings.get("seeds", ()))
    }
    done = wanted & set(results.parts)
    lines = []
    if done != wanted:
        lines.append(f"**Not finished: {len(done):,} of {len(wanted):,} trainings are done.** This page covers these.")
    _, failures = read_state(results.folder)
    failed = {key: reason for key, reason in failures.items() if key not in done}
    if failed:
        lines += ["", "Failed when last tried:", ""]
    for key, reason in failed.items():
        seed = "" if key.seed is None else f", seed {key.seed}"
        lines.append(f"- `{key.policy}` on {key.scenario}{seed}: {' '.join(reason.split())}")
    return "\n".join(lines).lstrip("\n")


def _results(results: StudyResults) -> Iterator[str]:
    """A table for each scenario, the best first."""
    yield _NOTE + (_BOUND_NOTE if results.bounds else "")
    yield "\n".join(_published(results))
    scores = study_scores(results)
    mixed = [scenario for scenario in scores if results.on_several_processors(scenario)]
    if mixed:
        yield _SEVERAL_PROCESSORS.format(where="" if len(mixed) == len(scores) else f" on {', '.join(mixed)}")
    for scenario, found in scores.items():
        yield f"## {scenario}\n\n" + table(_HEAD, map(_cells, found))


def _published(results: StudyResults) -> Iterator[str]:
    """Which variants have the name of other settings than theirs, as `mappo` from nothing has."""
    for variant in results.algorithms:
        if (name := results.published(variant)) != variant:
            yield f"Here `{variant}` has the settings of `uavaou train --algorithm {name}`."


def _cells(one: PolicyScores) -> tuple[str, ...]:
    alone = one.scores.size == 1 and not one.seeds  # the bound
    return (
        one.policy if alone else f"`{one.policy}`",
        one.knows,
        str(one.seeds or ""),
        with_interval(*one.mean, digits=_DIGITS),
        "" if alone else with_interval(*one.interquartile_mean, digits=_DIGITS),
        "" if one.wall_s is None else f"{rounded(one.wall_s / 60)} min",
        "" if one.violations is None else f"{one.violations:,}",
    )


def against_reference(results: StudyResults) -> list[Ablation]:
    """The variants against the reference, in the scenarios that it has been evaluated on; nothing without one."""
    means, reference = {}, results.reference
    for scenario in results.scenarios:
        scores = {name: results.stack(name, scenario) for name in results.algorithms}
        found = {name: table.mean(axis=1) for name, table in scores.items() if table.size}
        if reference in found:
            means[scenario] = found
    return [] if reference is None else ablations(means, reference)


def _comparison(results: StudyResults) -> list[str]:
    found = against_reference(results)
    return [f"## Against `{results.reference}`", ablation_table(found)] if found else []


def _trainings(results: StudyResults) -> list[str]:
    """The page's part on each training; nothing where no training has validations."""
    parts = []
    for scenario in results.scenarios:
        rows = [row for variant in results.algorithms for row in _trainings_rows(results, variant, scenario)]
        parts += [f"### {scenario}"] if rows and len(results.scenarios) > 1 else []
        parts += [table(_TRAININGS_HEAD, rows)] if rows else []
    return [f"## Trainings\n\n{_TRAININGS_NOTE}", *parts] if parts else []


def _trainings_rows(results: StudyResults, variant: str, scenario: str) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    trainings = results.trainings(variant, scenario)
    for run, one in zip(results.curves(VALIDATION, variant, scenario), trainings.itertuples(), strict=False):
        aou = run["mean_aou_slots"]
        moment, level = converged(aou), rounded(float(smooth(aou).min()), 4)
        at = f"{int(run['x'][moment.place]):,} slots" if moment.happened else "never"
        found.append((f"`{variant}`", str(one.seed), rounded(float(one.mean_aou_slots), 4), level, at))
    return found


def claims_markdown(claims: Sequence[Claim]) -> str:
    """The table of the verdicts, the rules they follow and the command that made the study."""
    commands = list(dict.fromkeys(claim.command for claim in claims))
    return "\n".join([table(_CLAIMS_HEAD, map(_claim_cells, claims)), "", _RULES, "", "```", *commands, "```"])


def _claim_cells(claim: Claim) -> tuple[str, ...]:
    quote = f"“{claim.quote}”" if claim.quote else "(ours)"
    value = between = ""
    if claim.estimate is not None:
        value = rounded(claim.estimate.value)
        low, high = claim.estimate.low, claim.estimate.high
        between = "none: one training" if np.isnan(low) else f"{rounded(low)} to {rounded(high)}"
    return claim.claim, quote, claim.measured, value, between, f"**{claim.verdict}**"


def begin_marker(study: str) -> str:
    """The line before the verdicts of a study."""
    return begin(f"claims:{quote(study, safe='')}")


def write_claims(readme: Path, study: str, claims: Sequence[Claim]) -> str:
    """Put the table of the claims between the markers of a README, in place of what is there.

    A README without markers gets them, with a heading, at its end; a missing README is created. A README whose markers
    name another study is left as it is; a marker without a name accepts any study.

    Returns:
        The study whose verdicts the README has now.

    Raises:
        InputError: the file cannot be read or written, or has one marker without the other.
    """
    text = read_text(readme, _MOST_BYTES) if readme.exists() else "# Results\n"
    name = f"claims:{quote(study, safe='')}"
    held = [found for _, found, _ in BLOCK.findall(text) if found.partition(":")[0] == "claims"]
    if text.count(begin("claims")[:-4]) != len(held) or len(held) > 1:
        raise InputError(f"{readme}: expected '{begin('claims:STUDY')}' once and then '{END}'")
    if not held:
        text = f"{text.rstrip()}\n\n## The paper's claims\n\n{begin(name)}\n{END}\n"
    elif held[0] not in ("claims", name):
        return unquote(held[0].partition(":")[2])
    text = text.replace(begin("claims"), begin(name))
    write_text(readme, filled(text, {name: lambda: f"\n{claims_markdown(claims)}\n"}))
    return study
