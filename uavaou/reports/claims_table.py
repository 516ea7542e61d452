"""The verdicts as Markdown, in a README between two markers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uavaou.errors import InputError
from uavaou.experiments.study_results import StudyResults
from uavaou.files import read_text, replacing
from uavaou.reports.claims import Claim, judge
from uavaou.reports.convergence import SMOOTHED, WITHIN

BEGIN, END = "<!-- claims:begin -->", "<!-- claims:end -->"
_MOST_BYTES = 5_000_000

_RULES = f"""\
Verdicts are computed. *Supported*: the whole 95 % interval lies on the claimed side; for a reduction to a share, the
interval holds the share or lies below it, and excludes 1. *Partly supported*: the estimate alone lies there; for a
reduction, there is one, but smaller than claimed. Intervals: stratified bootstrap, seeds and missions resampled with
replacement within each scenario. A training has converged at the first evaluation from which on its validation AoU,
averaged over {SMOOTHED} evaluations, stays within {WITHIN:.0%} of its own best."""


def claims_markdown(claims: Sequence[Claim]) -> str:
    """The table of the verdicts, the rules they follow and the command that made the study."""
    lines = [
        "| claim | the paper's words | measured | estimate | 95 % interval | verdict |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for claim in claims:
        quote = f"“{claim.quote}”" if claim.quote else "(ours)"
        cells = [claim.claim, quote, claim.measured, *_cells(claim), f"**{claim.verdict}**"]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    commands = list(dict.fromkeys(claim.command for claim in claims))
    return "\n".join([*lines, "", _RULES, "", "```", *commands, "```"])


def _cells(claim: Claim) -> tuple[str, str]:
    if claim.estimate is None:
        return "", ""
    value, low, high = claim.estimate
    return f"{value:.3g}", "none: one run" if np.isnan(low) else f"{low:.3g} to {high:.3g}"


def write_claims(readme: Path, results: StudyResults) -> list[Claim]:
    """Judge the claims and put their table between the markers of a README, in place of what is there.

    A README without markers gets them, with a heading, at its end; one that does not exist is made.

    Returns:
        The claims.

    Raises:
        InputError: the file cannot be read or written, or has one marker without the other.
    """
    claims = judge(results)
    text = read_text(readme, _MOST_BYTES) if readme.exists() else "# Results\n"
    if BEGIN not in text and END not in text:
        text = f"{text.rstrip()}\n\n## The paper's claims\n\n{BEGIN}\n{END}\n"
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in after or END in before:
        raise InputError(f"{readme}: expected '{BEGIN}' once and then '{END}' once")
    try:
        with replacing(readme) as file:
            file.write(f"{before}{BEGIN}\n\n{claims_markdown(claims)}\n\n{END}{after}")
    except OSError as error:
        raise InputError(f"{readme}: cannot be written: {error.strerror or error}") from error
    return claims
