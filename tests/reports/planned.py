"""What the page of planners says, from the tables of these."""

from __future__ import annotations

from tests.committed import RESULTS, means, rows, states
from uavaou.planners.exact import program_size
from uavaou.scenario import Scenario

GAP = {(row["scenario"], row["policy"]): float(row["mean_aou_slots"]) for row in rows("planners/gap.csv")}
LAYOUTS = [f"paper+layout_seed={seed}" for seed in range(6)]


def better_than_plans(text: str) -> bool:
    better = [seed for seed, name in enumerate(LAYOUTS) if GAP[name, "local-greedy-parts"] < GAP[name, "anneal"]]
    return better == [0, 1, 3, 4, 5] and states(text, "0, 1, 3, 4 and 5")


def best_planner(text: str) -> bool:
    """The layouts on which ``local-greedy-tuned`` is; of those with other planners in the table."""
    found = []
    for seed in range(6):
        rivals = {policy: mean for (name, policy), mean in GAP.items() if name == LAYOUTS[seed] and policy != "bound"}
        if min(rivals, key=lambda name: rivals[name]) == "local-greedy-tuned":
            found.append(str(seed))
    return f"layout seeds {', '.join(found[:-1])} and {found[-1]}." in text


def tuned_row(_: str) -> bool:
    """The row of 600 s of the page's table, with intervals."""
    page = (RESULTS.parent / "docs" / "planners.md").read_text(encoding="utf-8")
    found = [row for row in rows("planners/gap.csv") if row["policy"] == "local-greedy-tuned"]
    cells = [f"{float(row['mean_aou_slots']):.1f} ({float(row['low']):.1f}–{float(row['high']):.1f})" for row in found]
    return len(cells) == 6 and f"| 600 s | {' | '.join(cells)} |" in page


def bound_minutes(text: str) -> bool:
    found = [row for row in rows("planners/gap.csv") if row["policy"] == "bound" and row["scenario"] in LAYOUTS]
    minutes = [float(row["seconds"]) / 60 for row in found]
    return len(minutes) == 6 and f"{min(minutes):.1f} to {max(minutes):.1f} minutes" in text


def fast_beside_greedy(text: str) -> bool:
    return states(text, *(f"{GAP[LAYOUTS[seed], 'anneal'] / GAP[LAYOUTS[seed], 'greedy']:.2f}" for seed in (1, 2, 3)))


def rules_on_paper(text: str) -> bool:
    found = means("paper", "paper")
    return states(text, *(f"{found[name]:.1f}" for name in ("local-greedy", "local-greedy-parts")))


def variables(text: str) -> bool:
    return states(text, f"{program_size(Scenario.load('paper')):,}")


def solved_exactly(text: str) -> bool:
    """Seconds at 14, 16 and 20 slots of 25 cells."""
    seconds = {int(row["slots"]): float(row["seconds"]) for row in rows("planners/exact.csv") if row["cells"] == "25"}
    return (round(seconds[16] / seconds[14]), round(seconds[20] / seconds[16])) == (8, 2) and "eightfold" in text


def widest_gap(text: str) -> bool:
    last = rows("planners/exact.csv")[-1]
    return states(text, f"{float(last['gap']):.0%}".replace("%", " %"), f"{round(int(last['variables']), -3):,}")
