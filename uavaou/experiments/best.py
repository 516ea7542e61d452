"""The best run of each variant on each scenario, kept as a small run folder with a model card; its recorded mission.

Runs are ranked by validation: the missions of the final evaluation choose nothing.
"""

import shutil
from itertools import product
from pathlib import Path
from urllib.parse import unquote

from uavaou.errors import InputError
from uavaou.evaluation.flights import PartKey
from uavaou.evaluation.recorded_mission import RecordedMission, read_mission, record_mission, write_mission
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.experiments.results import StudyResults
from uavaou.experiments.study import Study
from uavaou.files import folder_name, replacing, write_text, writing
from uavaou.runs.folder import RunConfig, RunFolder, RunMeta
from uavaou.runs.names import config_folder
from uavaou.zoo import read_yaml_mapping


def keep_best(results: StudyResults, study: Study, out: Path) -> None:
    """Copy the best run of each variant and scenario into the results, and drop those it is better than.

    A run is copied only where its folder and its evaluation on the study's missions are at hand and can be read.
    Until then the run kept before stays.

    Raises:
        InputError: the results cannot be written.
    """
    runs = dict(study.runs())
    for place, variant in product(study.scenarios, study.variants):
        trainings = results.trainings(variant, place).dropna(subset="best_slots")
        for seed in trainings.sort_values("best_slots", kind="stable")["seed"][:1]:
            key = PartKey(variant, place, int(seed))
            kept = RunFolder(results.folder.best(key))
            with writing(kept.path):
                _copy(results, config_folder(out, runs[key]), kept, key, runs[key], study.episodes)
                for other in kept.path.parent.glob("seed-*") if kept.best.is_file() else ():
                    if other != kept.path:
                        shutil.rmtree(other)


def _copy(
    results: StudyResults, source: RunFolder, kept: RunFolder, key: PartKey, config: RunConfig, episodes: int
) -> None:
    """Copy what ``uavaou eval`` and ``uavaou plot`` read, where the run is at hand and undamaged."""
    try:
        if not (source.best.is_file() and source.holds(config)):
            return
        meta = source.read_meta()
    except InputError:  # who gathers the results has told why
        return
    kept.best.parent.mkdir(parents=True, exist_ok=True)
    copies = [(source.best, kept.best), (source.meta, kept.meta), (source.config, kept.config)]
    copies += [(source.plan, kept.plan)] if source.plan.is_file() else []
    for path, there in copies:
        with replacing(there, "wb") as file:
            file.write(path.read_bytes())
    write_text(kept.path / "README.md", _model_card(results, key, config, episodes, meta))


def _model_card(results: StudyResults, key: PartKey, config: RunConfig, episodes: int, meta: RunMeta) -> str:
    """The model card of a kept run, in Markdown; ``episodes`` are those of its final evaluation."""
    scenario, algorithm, trainings = config.scenario, config.algorithm, results.trainings(key.policy, key.scenario)
    (one,) = trainings[trainings["seed"] == key.seed].itertuples()
    mean, low, high = (f"{end:.6g}" for end in results.mean(key))
    between = "" if low == "nan" else f" (95 % interval over the missions: {low} to {high})"
    packages = ", ".join(f"{name} {version}" for name, version in meta.versions.items() if version) or "-"
    seeds = len(trainings)
    chosen = f"the best of {seeds} seeds by their" if seeds > 1 else "the best checkpoint of its one seed by its"
    return f"""\
# {key}

A policy of {algorithm.name}, shared by all UAVs of the fleet, from the study `{results.name}`: {chosen} validation \
missions. Its test figures below chose nothing.

- **Trained on**: {key.scenario} ({scenario.uavs} UAVs, {scenario.devices} devices, {scenario.slots} slots; \
`config.yaml` has every quantity), {one.slots:,} slots = {one.agent_steps:,} agent steps, seed {key.seed}.
- **Sees and does**: observation `{algorithm.observation}`, collection `{algorithm.collection}` \
(docs/explanation/model.md says what they hold); {meta.best_action} actions.
- **Validation**: mean AoU {one.best_slots:.6g} slots.
- **Evaluation**: mean AoU {mean} slots{between} on {episodes} missions, seeds {EVALUATION_SEED} to \
{EVALUATION_SEED + episodes - 1}, which no training and no choice has seen; {one.violations} constraint violations. \
This is one seed: the others are in the study's table.
- **Meant for**: reproducing and comparing figures on this scenario, and as a rival to other policies.
- **Limits**: made for this number of UAVs and devices and, with a fixed layout, for this layout; on another one it \
flies, and how well nobody has measured. Trained and tested in simulation alone: it has met no wind, no obstacles and \
no failing radio, and is no flight controller.
- **Made with**: {packages}; Python {meta.python or "-"}, commit {meta.commit or "unknown"}.

AoU is in units of the slot length, summed over devices and averaged over slots. To play it, in this folder:

```
uavaou eval . --policy greedy
uavaou train --config config.yaml --out again
```

The second command trains it anew.
"""


def record_missions(study: Path) -> list[Path]:
    """Play one mission with the kept policy of each variant that figures show, and write ``mission-<variant>.json``.

    Figures then need no policy. All play the first mission of the evaluation, on the first of the study's scenarios
    that has kept policies. Earlier recordings of another scenario are removed.

    Args:
        study: ``results/studies/<name>``.

    Returns:
        The files, by variant; none where the study keeps no policies.

    Raises:
        InputError: a policy cannot be loaded, or a file not be written.
    """
    settings = read_yaml_mapping(study / "study.yaml")
    scenarios, drawn = settings.get("scenarios"), settings.get("drawn")
    for scenario in scenarios if isinstance(scenarios, dict) else ():
        folders = sorted((study / "best" / folder_name(scenario)).glob("*/seed-*"))
        folders = [path for path in folders if not isinstance(drawn, list) or unquote(path.parent.name) in drawn]
        if folders:
            written = [_record_mission(study, RunFolder(folder)) for folder in folders]
            shown = read_mission(written[0]).scenario
            for path in set(study.glob("mission-*.json")) - set(written):  # one figure shows all that are there
                if read_mission(path).scenario != shown:
                    path.unlink()
            return written
    return []


def _record_mission(study: Path, run: RunFolder) -> Path:
    from uavaou.runs.policy import load_run  # imports torch, which reading results does without

    config, variant = run.read_config(), run.path.parent.name
    recording = record_mission(config.scenario, load_run(run), EVALUATION_SEED)
    path = study / f"mission-{variant}.json"
    write_mission(path, RecordedMission(config.scenario, unquote(variant), config.seed, EVALUATION_SEED, recording))
    return path
