"""A study in the format of marl-eval, so that its tables and plots can be made by others' tools.

The format is that of Gorsane et al. (NeurIPS 2022, arXiv 2209.10485), as https://github.com/instadeepai/marl-eval
describes it: environment, task, algorithm, run, then one entry for each evaluation and ``absolute_metrics``.
"""

from typing import Any

from uavaou.evaluation.flights import VALIDATION
from uavaou.experiments.results import StudyResults

ENVIRONMENT, FINAL = "uavaou_v0", "absolute_metrics"


def to_marl_eval(results: StudyResults) -> dict[str, Any]:
    """The learned variants of a study, ready for ``json.dump``.

    A task is a scenario. Each step is an evaluation on the validation missions, with ``step_count`` in training
    slots and ``elapsed_time`` in s; ``absolute_metrics`` are the means over the missions of the final evaluation.
    Every metric is a list of one number: ``return``, the reward of a mission in s, of which more is better as
    marl-eval assumes, and ``mean_aou_slots``, of which less is better; the final ones have ``communications``
    and ``devices_served`` besides. marl-eval wants equally many runs and steps everywhere: variants and tasks
    keep those that all have, the first ones.

    Raises:
        InputError: the study holds no evaluated run.
    """
    study = results.require_evaluated()
    tables = {name: {task: _runs(study, name, task) for task in study.scenarios} for name in study.algorithms}
    whole = {name: tasks for name, tasks in tables.items() if all(tasks.values())}
    every = [runs for tasks in whole.values() for runs in tasks.values()]
    seeds = min(map(len, every), default=0)
    steps = min((len(run) - 1 for runs in every for run in runs), default=0)

    def kept(run: dict[str, Any]) -> dict[str, Any]:
        return {name: run[name] for name in (*(f"step_{step}" for step in range(steps)), FINAL)}

    tasks = {
        task: {
            name: {f"seed_{seed}": kept(run) for seed, run in enumerate(runs[task][:seeds])}
            for name, runs in whole.items()
        }
        for task in study.scenarios
    }
    return {ENVIRONMENT: tasks}


def _runs(study: StudyResults, variant: str, task: str) -> list[dict[str, Any]]:
    """The validations and the final evaluation of each training."""
    mission_s, found = study.mission_s(task), []
    trainings = study.trainings(variant, task)
    for curve, final in zip(study.curves(VALIDATION, variant, task), trainings.to_dict("records"), strict=False):
        run: dict[str, Any] = {
            f"step_{step}": {
                "step_count": int(slots),
                "elapsed_time": wall_s,
                "return": [-mission_s * aou],
                "mean_aou_slots": [aou],
            }
            for step, (slots, wall_s, aou) in enumerate(
                zip(*(curve[name].tolist() for name in ("x", "wall_s", "mean_aou_slots")), strict=True)
            )
        }
        metrics = {name: [final[name]] for name in ("mean_aou_slots", "communications", "devices_served")}
        found.append(run | {FINAL: {"return": [-mission_s * final["mean_aou_slots"]], **metrics}})
    return found
