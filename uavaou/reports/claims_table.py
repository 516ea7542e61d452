"""The verdicts as Markdown, in a README between two markers."""

import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from uavaou.errors import InputError
from uavaou.files import read_text, write_text
from uavaou.reports.markdown import rounded, table
from uavaou.reports.training_claims import SMOOTHED, WITHIN
from uavaou.reports.verdicts import Claim

END = "<!-- claims:end -->"
_BEGIN = re.compile(r"<!-- claims:begin(?: (\S+))? -->")
_MOST_BYTES = 5_000_000

_RULES = f"""\
Verdicts are computed. On a direction: *supported* where the whole 95 % interval lies on the claimed side, *partly
supported* where the estimate alone does, else *not supported*. On a reduction to a share: *supported* where the whole
interval is at or below the share; *partly supported* where the estimate alone is, or where there is a reduction (the
whole interval is below 1) that does not reach the share; else *not supported*. One training of an algorithm has no
interval and supports a claim partly at best. Where some of MAPPO's trainings never converge or never reach the level, a
claim about that is *partly supported* at best; where none of them does, it is *not supported*. *A figure* is an
estimate that nobody made a claim about.

Ratios are those of geometric means over trainings, with Welch's interval on the logarithms; against a planner or the
bound, which is one number, with Student's. The correlation's interval is Student's over seeds. The sample is that of
trainings: each counts with the mean of its missions. A training has converged at the first evaluation from which on its
validation AoU, averaged over {SMOOTHED} evaluations, stays within {WITHIN:.0%} of its own best. The level of an
algorithm's trainings is {WITHIN:.0%} above the mean of the best such AoU of each of them; a training reaches it at its
first evaluation at or below it. A training that never converges or never reaches the level counts with its whole
budget."""
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
        between = "none: one training" if np.isnan(low) else f"{rounded(low)} to {rounded(high)}"
    return claim.claim, quote, claim.measured, value, between, f"**{claim.verdict}**"


def begin_marker(study: str) -> str:
    """The line before the verdicts of a study."""
    return f"<!-- claims:begin {quote(study, safe='')} -->"


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
    begins = list(_BEGIN.finditer(text))
    if not begins and "<!-- claims:" not in text:
        before, after = f"{text.rstrip()}\n\n## The paper's claims\n\n", "\n"
    else:
        before, held, after = _around(text, begins, readme)
        if held not in (None, study):
            return held
    write_text(readme, f"{before}{begin_marker(study)}\n\n{claims_markdown(claims)}\n\n{END}{after}")
    return study


def _around(text: str, begins: Sequence[re.Match[str]], readme: Path) -> tuple[str, str | None, str]:
    """The text before and after the markers, and the study that they name."""
    end = text.find(END)
    if len(begins) != 1 or text.count(END) != 1 or end < begins[0].end():
        raise InputError(f"{readme}: expected '<!-- claims:begin STUDY -->' once and then '{END}' once")
    name = begins[0][1]
    return text[: begins[0].start()], None if name is None else unquote(name), text[end + len(END) :]
