"""A study in the format of marl-eval, so that its tables and plots can be made by others' tools.

The format is that of Gorsane et al. (NeurIPS 2022, arXiv 2209.10485), as https://github.com/instadeepai/marl-eval
describes it: environment, task, algorithm, run, then one entry for each evaluation and ``absolute_metrics``.
"""

from typing import Any

from uavaou.evaluation.flights import PartKey
from uavaou.experiments.results import StudyResults

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
    study = results.require_evaluated()
    seeds = {(variant, task): _seeds(study, variant, task) for variant in study.algorithms for task in study.scenarios}
    variants = [name for name in study.algorithms if all(seeds[name, task] for task in study.scenarios)]
    whole = [PartKey(name, task, seed) for name in variants for task in study.scenarios for seed in seeds[name, task]]
    runs = min((len(seeds[name, task]) for name in variants for task in study.scenarios), default=0)
    steps = min((len(study.parts[key]["validation"]) for key in whole), default=0)
    tasks = {
        task: {
            name: {f"seed_{seed}": _run(study, PartKey(name, task, seed), steps) for seed in seeds[name, task][:runs]}
            for name in variants
        }
        for task in study.scenarios
    }
    return {ENVIRONMENT: tasks}


def _seeds(study: StudyResults, variant: str, task: str) -> list[int]:
    """The seeds with validations and a final evaluation."""
    return sorted(
        key.seed for key, tables in study.parts.items()
        if key[:2] == (variant, task) and key.seed is not None and {"validation", "missions"} <= tables.keys()
    )  # fmt: skip


def _run(study: StudyResults, key: PartKey, steps: int) -> dict[str, Any]:
    validation, missions = (study.table(name, *key) for name in ("validation", "missions"))
    mission_s = study.mission_s(key.scenario)
    content: dict[str, Any] = {}
    for step in range(steps):
        aou = float(validation["mean_aou_slots"][step])
        content[f"step_{step}"] = {
            "step_count": int(validation["slots"][step]),
            "elapsed_time": float(validation["wall_s"][step]),
            "return": [-mission_s * aou],
            "mean_aou_slots": [aou],
        }
    content["absolute_metrics"] = {
        "return": [float(missions["reward_s"].mean())],
        **{name: [float(missions[name].mean())] for name in ("mean_aou_slots", "communications", "devices_served")},
    }
    return content
