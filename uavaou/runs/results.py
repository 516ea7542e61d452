"""The evaluations of a run, ``eval/*.json``: written, read and searched here alone.

``eval/default.json`` holds the missions of the run's own scenario, ``eval/<suite>.json`` the points of a suite. A
study of fewer missions than ``default.json`` holds adds ``eval/first-<episodes>.json``, a part of the same missions,
which :func:`read_evaluations` leaves out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, model_validator

from uavaou.algorithms.io.tensor_file import POLICY, ArrayFile
from uavaou.errors import InputError
from uavaou.evaluation.evaluate import Evaluation
from uavaou.evaluation.seeds import EVALUATION_SEED
from uavaou.fields import Numbers, Whole, validated
from uavaou.files import read_json, write_json
from uavaou.planners.base import Planner
from uavaou.runs.checkpoint_header import TrainingProgress
from uavaou.runs.folder import RunConfig, RunFolder
from uavaou.scenario import Scenario
from uavaou.statistics import band_over_missions
from uavaou.world.knowledge import knowledge

_PART = re.compile(r"first-\d+")  # the name of an evaluation whose missions are part of default.json's
_OF_EACH_MISSION = (
    "mean_aou_s", "communications", "devices_served", "flight_time_s", "rejected_rate", "rejected_association",
    "device_communications",
)  # fmt: skip


def _of_dimensions(dimensions: int, name: str) -> AfterValidator:
    def check(array: NDArray[Any]) -> NDArray[Any]:
        if array.ndim != dimensions:
            raise ValueError(f"expected a {name} of numbers")
        return array

    return AfterValidator(check)


Values = Annotated[Numbers, _of_dimensions(1, "list")]
Table = Annotated[Numbers, _of_dimensions(2, "table")]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", arbitrary_types_allowed=True)

    def to_dict(self) -> dict[str, Any]:
        """The content of the file, or this part of it."""
        return self.model_dump(mode="json", exclude_none=True)


class PolicyResult(_Model):
    """What one policy did in the missions of one evaluation; None where the file does not say."""

    mean_aou_s: Values  # (n,) s
    communications: Values  # (n,)
    devices_served: Values  # (n,)
    flight_time_s: Table | None = None  # (n, U) s
    violations: dict[str, Whole] = {}  # of all missions together
    rejected_rate: Values | None = None  # (n,)
    rejected_association: Values | None = None  # (n,)
    aou_over_time_s: Values | None = None  # (K,) s, mean over the missions
    device_mean_aou_s: Values | None = None  # (I,) s, mean over the missions
    device_communications: Table | None = None  # (n, I)
    aou_over_time_low_s: Values | None = None  # (K,) s, of the 95 % interval; None for one mission
    aou_over_time_high_s: Values | None = None  # (K,) s
    update_period_slots: Values | None = None  # (I,) k_i; None where each mission draws a layout
    knows: str | None = None  # what the policy reads in flight: nothing, location, local, shared or everything
    action: str | None = None  # of a trained policy: greedy or sample
    policy_sha256: str | None = None  # of a trained policy: the digest of its weights

    @model_validator(mode="after")
    def _agree(self) -> Self:
        period, counts = self.update_period_slots, self.device_communications
        if period is not None and counts is not None and counts.shape[1] != len(period):
            raise ValueError(
                f"device_communications has {counts.shape[1]} devices, update_period_slots has {len(period)}"
            )
        return self

    @classmethod
    def of(cls, evaluation: Evaluation, scenario: Scenario, policy: Planner) -> PolicyResult:
        """The part of an evaluation file that belongs to ``policy``, which played ``evaluation`` in ``scenario``."""
        means = band_over_missions(evaluation.aou_over_time_s)  # (K,) each
        several = len(evaluation.aou_over_time_s) > 1  # one mission has no interval
        return cls(
            **{name: evaluation.values(name) for name in _OF_EACH_MISSION},
            violations=evaluation.violations,
            aou_over_time_s=means.value,
            device_mean_aou_s=evaluation.values("device_mean_aou_s").mean(axis=0),
            aou_over_time_low_s=means.low if several else None,
            aou_over_time_high_s=means.high if several else None,
            update_period_slots=scenario.draw_layout().update_period if scenario.layout == "fixed" else None,
            knows=knowledge(policy),
            action=getattr(policy, "action", None),  # planners have neither
            policy_sha256=getattr(policy, "digest", None) or None,
        )


class EvaluationFile(_Model):
    """Policies on the same missions of one scenario."""

    scenario: str
    episodes: Whole
    seed: Whole | None = None  # of mission 0
    policies: dict[str, PolicyResult]  # the run's own under its algorithm's name


class SuitePoint(_Model):
    """Policies on the same missions of one point of a suite."""

    label: str
    x: float
    set: dict[str, Any]  # scenario fields that the point changes
    observation: str | None = None
    how: dict[str, str]  # policy -> trained, zero-shot or planner
    trained_on: dict[str, str] = {}  # trained policy -> its scenario or family, named as its folder of results
    policies: dict[str, PolicyResult]


class SuiteEvaluationFile(_Model):
    """Policies on the points of a suite."""

    suite: str
    scenario: str
    episodes: Whole
    seed: Whole | None = None
    points: list[SuitePoint]


def read_evaluation(path: Path) -> EvaluationFile | SuiteEvaluationFile:
    """Read one evaluation file, of a scenario or of a suite.

    Raises:
        InputError: it cannot be read, or a field of it is missing or cannot be used.
    """
    content = read_json(path)
    if isinstance(content, dict) and "points" in content:
        return validated(SuiteEvaluationFile, content, str(path))
    return validated(EvaluationFile, content, str(path))


def read_evaluations(folder: RunFolder) -> dict[str, dict[str, PolicyResult]]:
    """The evaluations of a run on what it was trained for: name of the file -> policy -> result.

    Those are ``default``, and each suite whose one point is what the run was trained for. ``first-<episodes>`` counts
    only where ``default.json`` is gone, and then the largest alone: no mission appears twice.

    Raises:
        InputError: a file cannot be read, or a field of it is missing or cannot be used.
    """
    found: dict[str, dict[str, PolicyResult]] = {}
    parts: list[tuple[int, str]] = []
    for path in sorted(folder.path.glob("eval/*.json")):
        content = read_evaluation(path)
        if isinstance(content, SuiteEvaluationFile):
            if len(content.points) == 1 and "trained" in content.points[0].how.values():
                found[path.stem] = content.points[0].policies
            continue
        found[path.stem] = content.policies
        if _PART.fullmatch(path.stem):
            parts.append((content.episodes, path.stem))
    for _, name in sorted(parts)[: None if "default" in found else -1]:
        del found[name]
    return found


def find_evaluation(folder: RunFolder, algorithm: str, episodes: int) -> PolicyResult | None:
    """The result of a run's policy on the first ``episodes`` missions; None where there is none that can be read.

    Only an evaluation of the present best checkpoint counts, with the action that it was chosen by: ``uavaou eval``
    may have played another action, or the best policy of an earlier time in the training.

    Raises:
        InputError: there is one, and the checkpoint cannot be read.
    """
    found = [
        file.policies[algorithm]
        for file in (_readable(folder.evaluation(name)) for name in ("default", f"first-{episodes}"))
        if isinstance(file, EvaluationFile) and (file.episodes, file.seed) == (episodes, EVALUATION_SEED)
        if algorithm in file.policies
    ]
    if not found or not folder.policy.is_file():
        return None
    checkpoint = ArrayFile(folder.policy)
    present = checkpoint.digest(POLICY), TrainingProgress.read(checkpoint).best_action
    return next((one for one in found if (one.policy_sha256, one.action) == present), None)


def _readable(path: Path) -> EvaluationFile | SuiteEvaluationFile | None:
    try:
        return read_evaluation(path)
    except InputError:
        return None


def write_evaluation(path: Path, content: EvaluationFile | SuiteEvaluationFile, digits: int | None = None) -> None:
    """Write an evaluation file.

    Args:
        path: of the file.
        content: of the file; that of a suite, which is large, goes on one line.
        digits: significant digits to keep of every number, in a file of one line; None for all.

    Raises:
        InputError: it cannot be written.
    """
    one_line = digits is not None or isinstance(content, SuiteEvaluationFile)
    plain = content.to_dict() if digits is None else _rounded(content.to_dict(), digits)
    write_json(path, plain, indent=None if one_line else 1)


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(inner, digits) for key, inner in value.items()}
    if isinstance(value, list):
        return [_rounded(inner, digits) for inner in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def keep_evaluation(path: Path, content: EvaluationFile | SuiteEvaluationFile) -> str:
    """Write an evaluation into a run's folder, unless one of more missions is there; returns a note on what it did."""
    there = _readable(path)
    if there is not None and there.episodes > content.episodes:
        return f"kept {path}: it is of more missions"
    try:
        write_evaluation(path, content)
    except InputError as error:
        return str(error)
    return f"wrote {path}"


def write_own_evaluation(folder: RunFolder, config: RunConfig, result: PolicyResult) -> None:
    """Write the evaluation of a run on its own scenario; a ``default.json`` of more missions is kept beside it.

    Raises:
        InputError: it cannot be written.
    """
    content = own_evaluation(config, result)
    there = _readable(folder.evaluation())
    taken = there is not None and there.episodes > content.episodes
    write_evaluation(folder.evaluation(f"first-{content.episodes}" if taken else "default"), content)


def own_evaluation(
    config: RunConfig, result: PolicyResult, seed: int = EVALUATION_SEED, others: Mapping[str, PolicyResult] = {}
) -> EvaluationFile:
    """The content of a run's ``default.json``: its policy, under the algorithm's name, and others on its missions."""
    policies = {config.algorithm.name: result, **others}
    return EvaluationFile(scenario=config.scenario.name, episodes=len(result.mean_aou_s), seed=seed, policies=policies)
