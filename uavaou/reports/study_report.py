"""The report of a study: a page of tables beside its condensed results, and what other tools read.

``results/studies/<name>/README.md`` holds the table of every scenario, the comparison with the study's reference
where it names one, and the verdicts on the paper's claims where it judges them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from uavaou.errors import InputError
from uavaou.experiments.folder import write_json
from uavaou.experiments.marl_eval import to_marl_eval
from uavaou.experiments.stratified import interquartile_mean, mean_score
from uavaou.experiments.study_results import StudyResults, read_study, rows_of
from uavaou.experiments.study_tables import StudyTables, by_run
from uavaou.files import replacing
from uavaou.reports.ablations import ablation_table, ablations
from uavaou.reports.claims import judge
from uavaou.reports.claims_table import claims_markdown, write_claims

_NOTE = """\
Mean AoU per slot in units of the slot length τ, over the missions of the final evaluation, which no training and no
choice of a checkpoint has seen. IQM: the mean of the middle half. Intervals: 95 %, stratified bootstrap, seeds and
missions resampled. Planners have one run and see everything; no policy's expected mean AoU can be below the bound."""
_HEAD = """\
| policy | seeds | mean AoU | IQM | wall-clock of a training | violations |
| --- | --- | --- | --- | --- | --- |"""


def write_report(folder: Path, results_page: Path) -> None:
    """Write ``README.md`` and ``marl-eval.json`` in a study's folder.

    Args:
        folder: ``results/studies/<name>``.
        results_page: gets the verdicts between its markers, where the study judges the paper's claims.

    Raises:
        InputError: the condensed results are missing or damaged, or a file cannot be written.
    """
    results = read_study(folder)
    tables = by_run(results)
    study = results.study
    parts = [
        f"# Study `{tables.name}`",
        str(study.get("description", "")),
        _commands(results),
        *_results(results, tables),
    ]
    reference = study.get("reference")
    if reference in tables.algorithms:
        rows = [dict(zip(results.missions, row, strict=True)) for row in zip(*results.missions.values(), strict=True)]
        parts += [f"## Against `{reference}`", ablation_table(ablations(rows, reference))]
    if study.get("claims"):
        parts += ["## The paper's claims", claims_markdown(judge(results))]
    try:
        with replacing(folder / "README.md") as file:
            file.write("\n\n".join(part for part in parts if part) + "\n")
        if tables.algorithms:
            write_json(folder / "marl-eval.json", to_marl_eval(results))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    if study.get("claims"):
        write_claims(results_page, results)


def _commands(results: StudyResults) -> str:
    name = results.path.name
    return f"```\nuavaou study run {name}\nuavaou study report {name}\nuavaou plot figures\n```"


def _results(results: StudyResults, tables: StudyTables) -> Iterator[str]:
    """A table for each scenario, the best first."""
    yield _NOTE
    for scenario in tables.scenarios:
        rows = sorted(_rows(results, tables, scenario))
        if rows:
            yield f"## {scenario}\n\n" + "\n".join([_HEAD, *(row for _, row in rows)])


def _rows(results: StudyResults, tables: StudyTables, scenario: str) -> Iterator[tuple[float, str]]:
    for variant in (*tables.algorithms, *tables.planners):
        scores = tables.missions(variant, "mean_aou_slots", [scenario])
        if not scores:
            continue
        runs = rows_of(results.runs, variant=variant, scenario=scenario)
        seeds = len(runs["seed"])
        minutes = f"{runs['wall_s'].mean() / 60:.1f} min" if seeds else ""
        violations = f"{runs['violations'].sum():,}" if seeds else ""
        mean = mean_score(scores)
        cells = (
            f"`{variant}`",
            str(seeds or ""),
            _figure(*mean),
            _figure(*interquartile_mean(scores)),
            minutes,
            violations,
        )
        yield mean[0], f"| {' | '.join(cells)} |"
    if scenario in tables.bounds:
        bound = tables.bounds[scenario]
        yield bound, f"| lower bound | | {bound:.4g} | | | |"


def _figure(value: float, low: float, high: float) -> str:
    return f"{value:.4g}" if math.isnan(low) else f"{value:.4g} ({low:.4g}–{high:.4g})"
