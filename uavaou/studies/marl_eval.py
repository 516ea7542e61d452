"""A study in the format of marl-eval, so that its tables and plots can be made by others' tools.

The format is that of Gorsane et al. (NeurIPS 2022, arXiv 2209.10485), as https://github.com/instadeepai/marl-eval
describes it: environment, task, algorithm, run, then one entry for each evaluation and ``absolute_metrics``.
"""

from __future__ import annotations

from typing import Any

from uavaou.studies.results import StudyResults
from uavaou.studies.tables import StudyTables, by_run

ENVIRONMENT = "uavaou_v0"


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
    study = by_run(results)
    variants = [name for name in study.algorithms if all(_runs(study, name, task) for task in study.scenarios)]
    counts = [len(_runs(study, name, task)) for name in variants for task in study.scenarios]
    seeds = min(counts, default=0)
    steps = min(
        (
            len(run["slots"])
            for name in variants
            for task in study.scenarios
            for run in _runs(study, name, task).values()
        ),
        default=0,
    )
    tasks = {
        task: {
            name: {
                f"seed_{seed}": _run(study, name, task, seed, steps)
                for seed in sorted(_runs(study, name, task))[:seeds]
            }
            for name in variants
        }
        for task in study.scenarios
    }
    return {ENVIRONMENT: tasks}


def _runs(study: StudyTables, variant: str, task: str) -> dict[int, Any]:
    """The validations of each seed that has also been evaluated."""
    found = study.tables["validation"]
    return {key[2]: found[key] for key in found if key[:2] == (variant, task) and key in study.tables["missions"]}


def _run(study: StudyTables, variant: str, task: str, seed: int, steps: int) -> dict[str, Any]:
    validation = study.tables["validation"][variant, task, seed]
    missions = study.tables["missions"][variant, task, seed]
    of_one_slot = -study.slots(task) * study.slot_length_s(task)  # s, the reward of a mission whose mean AoU is tau
    content: dict[str, Any] = {}
    for step in range(steps):
        aou = float(validation["mean_aou_slots"][step])
        content[f"step_{step}"] = {
            "step_count": int(validation["slots"][step]),
            "elapsed_time": float(validation["wall_s"][step]),
            "return": [of_one_slot * aou],
            "mean_aou_slots": [aou],
        }
    content["absolute_metrics"] = {
        "return": [float(missions["reward_s"].mean())],
        **{name: [float(missions[name].mean())] for name in ("mean_aou_slots", "communications", "devices_served")},
    }
    return content
