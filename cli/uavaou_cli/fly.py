"""``uavaou fly``: one mission at once, beside a reference, with its map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from uavaou.evaluation.seeds import EVALUATION_SEED, LARGEST_SEED
from uavaou_cli.evaluate import evaluation_lines
from uavaou_cli.options import Changes, Quiet, ScenarioName, number, option, writable_folder
from uavaou_cli.overrides import parse_overrides
from uavaou_cli.progress import EvaluationDisplay
from uavaou_cli.tables import say, show

if TYPE_CHECKING:
    from uavaou.world import World

_DEFAULT = "any-map"
_REFERENCES = ("best-first", "greedy")  # planners that need no time; also the default without a released policy


def fly(
    scenario: ScenarioName,
    policy: Annotated[
        str | None, option("A released policy, a run's folder or a planner. [default: any-map]", "NAME")
    ] = None,
    seed: Annotated[int, number("Seed of the mission.", 0, LARGEST_SEED)] = EVALUATION_SEED,
    out: Annotated[Path | None, option("Where the files go. [default: results/<scenario>/fly/<policy>]", "DIR")] = None,
    set_: Changes = None,
    quiet: Quiet = False,
) -> None:
    """Fly one mission of a scenario, print its figures beside a reference, and draw its map.

    Writes the mission as JSON and its pictures as PNG and PDF.
    """
    from uavaou.files import folder_name
    from uavaou.runs.comparison import compare, make_policy
    from uavaou.runs.folder import name_with, scenario_folder
    from uavaou.scenario import Scenario

    overrides = parse_overrides(set_ or [])
    overrides.only_of_scenario("a policy flies as it is")
    base = Scenario.load(scenario)
    flown = overrides.of_scenario(base)
    chosen = _default() if policy is None else policy
    reference = next(name for name in _REFERENCES if name != chosen)
    place = Path("results") / scenario_folder(base, overrides.scenario) / "fly"
    path = Path(chosen)
    folder = out or place / name_with(folder_name("-".join(path.relative_to(path.anchor).parts)), {})
    writable_folder(folder)
    policies = {name: make_policy(name, flown) for name in (chosen, reference)}
    with _FlightDisplay(quiet, list(policies), flown.slots) as display:
        comparison = compare(policies, flown, 1, seed, display)
    show(evaluation_lines(comparison, overrides.scenario))
    if policy is None and chosen != _DEFAULT:
        say([f"flown by {chosen}: no policy '{_DEFAULT}' comes with this version"], quiet)
    from uavaou.evaluation.recorded_mission import RecordedMission, Recording, write_mission
    from uavaou.reports.mission_figures import plot_trajectories

    recording = Recording.from_snapshots(display.snapshots)
    written = folder / f"mission-{seed}.json"
    write_mission(written, RecordedMission(flown, chosen, None, seed, recording))
    show(["", written, *plot_trajectories(flown, recording, folder, f"mission-{seed}")])


class _FlightDisplay(EvaluationDisplay):
    """Also keeps what every slot of the first policy's mission looked like."""

    def __init__(self, quiet: bool, names: list[str], slots: int) -> None:
        super().__init__(quiet, names, slots)
        self.snapshots: list[dict[str, Any]] = []

    def after_slot(self, slots: int, world: World) -> None:
        """``slots`` of the policy's are done."""
        super().after_slot(slots, world)
        if len(self.snapshots) < self._slots:
            self.snapshots.append(world.snapshot())


def _default() -> str:
    """The released policy for every map, or without it the best planner that needs no time to plan."""
    from uavaou.runs.released import released_names

    return _DEFAULT if _DEFAULT in released_names() else _REFERENCES[0]
