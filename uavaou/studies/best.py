"""The best run of each variant on each scenario, kept as a small run folder with a model card; its recorded mission.

Runs are ranked by validation: the missions of the final evaluation choose nothing.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from urllib.parse import unquote

from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission, read_mission, record_mission, write_mission
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.files import folder_name, replacing
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.runs.meta import RunMeta
from uavaou.runs.results import PolicyResult, find_evaluation, own_evaluation, write_evaluation
from uavaou.studies.parts import PartKey
from uavaou.studies.results import StudyResults
from uavaou.studies.study import Study, StudyRun
from uavaou.zoo import read_yaml_mapping

_DIGITS = 6


def keep_best(results: StudyResults, study: Study, out: Path) -> None:
    """Copy the best run of each variant and scenario into the results, and drop those it is better than.

    A run is copied only where its folder and its evaluation on the study's missions are at hand and can be read.
    Until then the run kept before stays.

    Raises:
        InputError: the results cannot be written.
    """
    ranked: dict[tuple[str, str], list[tuple[float, int, StudyRun]]] = {}
    for run in study.runs():
        variant, scenario, seed = run.key
        if run.key in results.parts and (score := results.cell(run.key, "best_slots")):
            assert seed is not None
            ranked.setdefault((variant, scenario), []).append((float(score), seed, run))
    for runs in ranked.values():
        _keep(results, study, out, min(runs, key=lambda scored: scored[:2])[-1])


def _keep(results: StudyResults, study: Study, out: Path, run: StudyRun) -> None:
    kept = RunFolder(results.folder.best(run.key))
    source = study.folder(out, run)
    found = _read(source, run.config, study.episodes)
    try:
        if found is not None:
            entry, meta = found
            _copy(source, kept, run.config, study.episodes, entry)
            with replacing(kept.path / "README.md") as file:
                file.write("\n".join(card_lines(results, study, run.key, meta)) + "\n")
        if kept.best.is_file():
            for other in kept.path.parent.glob("seed-*"):
                if other != kept.path:
                    shutil.rmtree(other)
    except OSError as error:
        raise InputError(f"cannot write to '{kept.path}': {error.strerror or error}") from error


def _read(source: RunFolder, config: RunConfig, episodes: int) -> tuple[PolicyResult, RunMeta] | None:
    """The evaluation and ``meta.json`` of a run; None where it is missing or damaged, which condensing it has told."""
    try:
        if not (source.best.is_file() and source.exists() and source.read_config() == config):
            return None
        entry = find_evaluation(source, config.algorithm.name, episodes)
        return None if entry is None else (entry, source.read_meta())
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


def card_lines(results: StudyResults, study: Study, key: PartKey, meta: RunMeta) -> list[str]:
    """The model card of a kept run, in Markdown."""
    scenario, algorithm = study.scenarios[key.scenario], study.variants[key.variant]
    row = {name: results.cell(key, name) for name in ("slots", "agent_steps", "best_slots", "mean_aou_slots")}
    low, high, violations = (results.cell(key, name) for name in ("low", "high", "violations"))
    between = f" (95 % interval over the missions: {low} to {high})" if low else ""
    packages = ", ".join(f"{name} {v}" for name, v in meta.versions.items() if v) or "-"
    others = sum(key[:2] == other[:2] for other in results.parts)
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
        f"(docs/model.md says what they hold); {meta.best_action} actions.",
        f"- **Validation**: mean AoU {row['best_slots']} slots.",
        f"- **Evaluation**: mean AoU {row['mean_aou_slots']} slots{between} on {study.episodes} missions, seeds "
        f"{EVALUATION_SEED} to {EVALUATION_SEED + study.episodes - 1}, which no training and no choice has seen; "
        f"{violations} constraint violations. This is one seed: the spread over seeds is in `runs.csv`.",
        "- **Meant for**: reproducing and comparing figures on this scenario, and as a rival to other policies.",
        "- **Limits**: made for this number of UAVs and devices and, with a fixed layout, for this layout; on another "
        "one it flies, and how well nobody has measured. Trained and tested in simulation alone: it has met no wind, "
        "no obstacles and no failing radio, and is no flight controller.",
        f"- **Made with**: {packages}; Python {meta.python or '-'}, commit {meta.commit or 'unknown'}.",
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


def record_missions(study: Path) -> list[Path]:
    """Play one mission with the kept policy of each variant and write ``mission-<variant>.json``.

    Figures then need no policy. All play the first mission of the evaluation, on the first of the study's scenarios
    that has kept policies. Earlier recordings of another scenario are removed.

    Args:
        study: ``results/studies/<name>``.

    Returns:
        The files, by variant; none where the study keeps no policies.

    Raises:
        InputError: a policy cannot be loaded, or a file not be written.
    """
    scenarios = read_yaml_mapping(study / "study.yaml").get("scenarios")
    for scenario in scenarios if isinstance(scenarios, dict) else ():
        folders = sorted((study / "best" / folder_name(scenario)).glob("*/seed-*"))
        if folders:
            written = [_record_mission(study, RunFolder(folder)) for folder in folders]
            _remove_others(study, written)
            return written
    return []


def _record_mission(study: Path, run: RunFolder) -> Path:
    from uavaou.runs.policy import load_run  # imports torch, which reading results does without

    config, variant = run.read_config(), run.path.parent.name
    recording = record_mission(config.scenario, load_run(run), EVALUATION_SEED)
    path = study / f"mission-{variant}.json"
    try:
        write_mission(path, RecordedMission(config.scenario, unquote(variant), config.seed, EVALUATION_SEED, recording))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path


def _remove_others(study: Path, written: list[Path]) -> None:
    """Remove an earlier report's recordings of another scenario: one figure shows all that are there."""
    scenario = read_mission(written[0]).scenario
    for path in set(study.glob("mission-*.json")) - set(written):
        if read_mission(path).scenario != scenario:
            path.unlink()
