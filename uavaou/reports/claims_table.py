"""The verdicts as Markdown, in a README between two markers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uavaou.errors import InputError
from uavaou.files import read_text, replacing
from uavaou.reports.convergence import SMOOTHED, WITHIN
from uavaou.reports.markdown import rounded, table
from uavaou.reports.verdicts import Claim

BEGIN, END = "<!-- claims:begin -->", "<!-- claims:end -->"
_MOST_BYTES = 5_000_000

_RULES = f"""\
Verdicts are computed. *Supported*: the whole 95 % interval lies on the claimed side; for a reduction to a share, the
interval holds the share or lies below it, and excludes 1. *Partly supported*: the estimate alone lies there; for a
reduction, there is one, but smaller than claimed; or all there is is one training of an algorithm, or some runs never
get where the claim has them. Intervals: stratified bootstrap, seeds and missions resampled with replacement within each
scenario. A training has converged at the first evaluation from which on its validation AoU, averaged over {SMOOTHED}
evaluations, stays within {WITHIN:.0%} of its own best."""
_HEAD = ("claim", "the paper's words", "measured", "estimate", "95 % interval", "verdict")


def claims_markdown(claims: Sequence[Claim]) -> str:
    """The table of the verdicts, the rules they follow and the command that made the study."""
    commands = list(dict.fromkeys(claim.command for claim in claims))
    return "\n".join([table(_HEAD, map(_cells, claims)), "", _RULES, "", "```", *commands, "```"])


def _cells(claim: Claim) -> tuple[str, ...]:
    quote = f"“{claim.quote}”" if claim.quote else "(ours)"
    value = between = ""
    if claim.estimate is not None:
        value = rounded(claim.estimate.value)
        low, high = claim.estimate.low, claim.estimate.high
        between = "none: one run" if np.isnan(low) else f"{rounded(low)} to {rounded(high)}"
    return claim.claim, quote, claim.measured, value, between, f"**{claim.verdict}**"


def write_claims(readme: Path, claims: Sequence[Claim]) -> None:
    """Put the table of the claims between the markers of a README, in place of what is there.

    A README without markers gets them, with a heading, at its end; one that does not exist is made.

    Raises:
        InputError: the file cannot be read or written, or has one marker without the other.
    """
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
