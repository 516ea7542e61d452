"""What docs/planners.md shows runs as it stands there, and it names every planner."""

import re
from pathlib import Path

import pandas as pd
import pytest

from uavaou.planners import PLANNERS, planner_knowledge

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")


def test_a_planner_of_your_own(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(code, {})
    assert 0 < float(capsys.readouterr().out) < 1000


def test_the_page_says_of_every_planner_what_it_knows() -> None:
    rows = {
        name: known for names, known in re.findall(r"^\| (`.*?) \| (\w+) \|", PAGE, re.M) for name in names.split(", ")
    }
    assert {name: rows[f"`{name}`"] for name in PLANNERS} == {name: planner_knowledge(name) for name in PLANNERS}


def test_what_they_reach_is_what_the_table_says() -> None:
    """Each figure of the page, with as many digits as it has, is the one in ``gap.csv``."""
    table = pd.read_csv(ROOT / "results" / "planners" / "gap.csv")
    names, means = zip(table["scenario"], table["policy"], strict=True), table["mean_aou_slots"]
    found = dict(zip(names, means.tolist(), strict=True))
    head, *rows = re.findall(r"^\| (?:scenario \| bound|`(?:tiny|quickstart|paper)).*", PAGE, re.M)[:9]
    policies = re.findall(r"bound|(?<=`)[a-z-]+(?=`)", head)[:-1]  # the last column is a ratio
    compared = 0
    for row in rows:
        scenario, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        name = re.sub(r"`paper`, layout seed (\d)", r"paper+layout_seed=\1", scenario).strip("`")
        for policy, cell in zip(policies, cells, strict=False):
            number = re.match(r"\**([\d.,]+)", cell)
            if number:
                digits = len(number[1].partition(".")[2])
                assert number[1].replace(",", "") == f"{found[name, policy]:.{digits}f}", (name, policy)
                compared += 1
    assert compared > 50
