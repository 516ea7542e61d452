"""Records a mission of each variant's kept policy, so that a study's pictures need no policy afterwards."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote

from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission, read_mission, record_mission, write_mission
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.files import folder_name
from uavaou.runs.folder import RunFolder
from uavaou.runs.policy import load_run
from uavaou.zoo import read_yaml_mapping


def record_study_missions(study: Path, mission_seed: int = EVALUATION_SEED) -> list[Path]:
    """Play one mission with the best policy of each variant and write ``mission-<variant>.json``.

    The policies are those in ``best/<scenario>/<variant>/seed-<n>/``, on the first of the study's scenarios that
    has any; all play the same mission. Earlier recordings of another scenario go.

    Args:
        study: ``results/studies/<name>``.
        mission_seed: of the mission.

    Returns:
        The files, by variant; none where the study keeps no policies.

    Raises:
        InputError: a policy cannot be loaded, or a file not be written.
    """
    scenarios = read_yaml_mapping(study / "study.yaml").get("scenarios")
    for scenario in scenarios if isinstance(scenarios, dict) else ():
        place = study / "best" / folder_name(scenario)
        folders = sorted(place.glob("*/seed-*"))
        if folders:
            written = [_record(study, folder, mission_seed) for folder in folders]
            _remove_others(study, written)
            return written
    return []


def _remove_others(study: Path, written: list[Path]) -> None:
    """Remove an earlier report's recordings of another scenario: one picture shows all that are there."""
    scenario = read_mission(written[0]).scenario
    for path in set(study.glob("mission-*.json")) - set(written):
        if read_mission(path).scenario != scenario:
            path.unlink()


def _record(study: Path, folder: Path, mission_seed: int) -> Path:
    run = RunFolder(folder)
    config = run.read_config()
    recording = record_mission(config.scenario, load_run(run), mission_seed)
    variant = unquote(folder.parent.name)
    path = study / f"mission-{folder.parent.name}.json"
    try:
        write_mission(path, RecordedMission(config.scenario, variant, config.seed, mission_seed, recording))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path
