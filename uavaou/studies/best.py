"""The best run of each variant on each scenario, kept as a small run folder with a model card.

Best by validation: the test missions of the final evaluation choose nothing.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uavaou.errors import InputError
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.files import read_json, replacing
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.results import PolicyResult, find_evaluation, own_evaluation, write_evaluation
from uavaou.studies.jobs import Key
from uavaou.studies.store import StudyStore
from uavaou.studies.study import Study

_DIGITS = 6


def keep_best(store: StudyStore, study: Study, out: Path) -> None:
    """Copy the best run of each variant and scenario into the results, and drop those it is better than.

    A best run whose folder, or whose evaluation on the study's missions, is not here or cannot be read is left out
    until ``study report`` finds it; the one kept before stays until then.

    Raises:
        InputError: the results cannot be written.
    """
    for scenario in study.scenarios:
        for variant in study.variants:
            seeds = [seed for seed in study.seeds if Key(variant, scenario, seed) in store]
            scored = [(store.cell(Key(variant, scenario, seed), "best_slots"), seed) for seed in seeds]
            ranked = sorted((float(score), seed) for score, seed in scored if score)
            if ranked:
                _keep(store, study, out, Key(variant, scenario, ranked[0][1]))


def _keep(store: StudyStore, study: Study, out: Path, key: Key) -> None:
    assert key.seed is not None
    kept = store.folder.best(key)
    config = RunConfig(study.scenarios[key.scenario], study.variants[key.variant], key.seed)
    run = next(run for run in study.runs() if (run.variant, run.scenario, run.seed) == tuple(key))
    source = study.folder(out, run)
    found = _read(source, config, study.episodes)
    try:
        if found is not None:
            entry, meta = found
            _copy(source, RunFolder(kept), config, study.episodes, entry)
            with replacing(kept / "README.md") as file:
                file.write("\n".join(card_lines(store, study, key, meta)) + "\n")
        if RunFolder(kept).best.is_file():
            for other in kept.parent.glob("seed-*"):
                if other != kept:
                    shutil.rmtree(other)
    except OSError as error:
        raise InputError(f"cannot write to '{kept}': {error.strerror or error}") from error


def _read(source: RunFolder, config: RunConfig, episodes: int) -> tuple[PolicyResult, dict[str, Any]] | None:
    """The evaluation and ``meta.json`` of a run; None where it is not here, or damaged: who condensed it told why."""
    try:
        if not (source.best.is_file() and source.exists() and source.read_config() == config):
            return None
        entry = find_evaluation(source, config.algorithm.name, episodes)
        return None if entry is None else (entry, read_json(source.meta))
    except InputError:
        return None


def _copy(source: RunFolder, kept: RunFolder, config: RunConfig, episodes: int, evaluation: PolicyResult) -> None:
    """Copy what ``uavaou eval`` and ``uavaou plot trajectories`` read."""
    kept.best.parent.mkdir(parents=True, exist_ok=True)
    for path, there in ((source.best, kept.best), (source.meta, kept.meta), (source.config, kept.config)):
        with replacing(there, "wb") as file:
            file.write(path.read_bytes())
    content = own_evaluation(config, evaluation, episodes, EVALUATION_SEED)
    write_evaluation(kept.evaluation(), content, _DIGITS)


def card_lines(store: StudyStore, study: Study, key: Key, meta: Mapping[str, Any]) -> list[str]:
    """The model card of a kept run, in Markdown."""
    scenario, algorithm = study.scenarios[key.scenario], study.variants[key.variant]
    row = {name: store.cell(key, name) for name in ("slots", "agent_steps", "best_slots", "mean_aou_slots")}
    low, high, violations = (store.cell(key, name) for name in ("low", "high", "violations"))
    between = f" (95 % interval over the missions: {low} to {high})" if low else ""
    versions = meta.get("versions")
    packages = ", ".join(f"{name} {v}" for name, v in versions.items() if v) if isinstance(versions, dict) else "-"
    others = sum(Key(key.variant, key.scenario, seed) in store for seed in study.seeds)
    task = f"{scenario.uavs} UAVs, {scenario.devices} devices, {scenario.slots} slots"
    return [
        f"# {key.variant} on {key.scenario}, seed {key.seed}",
        "",
        f"A policy of {algorithm.name}, shared by all UAVs of the fleet, from the study `{study.name}`: the best of "
        f"{others} seeds by their validation missions. Its test figures below chose nothing.",
        "",
        f"- **Trained on**: {key.scenario} ({task}; `config.yaml` has every quantity), {int(row['slots']):,} slots = "
        f"{int(row['agent_steps']):,} agent steps, seed {key.seed}.",
        f"- **Sees and does**: observation `{algorithm.observation}`, collection `{algorithm.collection}` "
        f"(docs/model.md says what they hold); {meta.get('best_action', 'greedy')} actions.",
        f"- **Validation**: mean AoU {row['best_slots']} slots.",
        f"- **Evaluation**: mean AoU {row['mean_aou_slots']} slots{between} on {study.episodes} missions, seeds "
        f"{EVALUATION_SEED} to {EVALUATION_SEED + study.episodes - 1}, which no training and no choice has seen; "
        f"{violations} constraint violations. This is one seed: the spread over seeds is in `runs.csv`.",
        "- **Meant for**: reproducing and comparing figures on this scenario, and as a rival to other policies.",
        "- **Limits**: made for this number of UAVs and devices and, with a fixed layout, for this layout; on another "
        "one it flies, and how well nobody has measured. Trained and tested in simulation alone: it has met no wind, "
        "no obstacles and no failing radio, and is no flight controller.",
        f"- **Made with**: {packages}; Python {meta.get('python', '-')}, commit {meta.get('commit') or 'unknown'}.",
        "",
        "AoU is in units of the slot length, summed over devices and averaged over slots. To play it, in this folder:",
        "",
        "```",
        "uavaou eval . --policy greedy",
        "OMP_NUM_THREADS=1 uavaou train --config config.yaml --out again",
        "```",
        "",
        "The second command trains it anew.",
    ]
