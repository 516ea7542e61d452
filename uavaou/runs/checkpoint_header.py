"""What a checkpoint's header says: the schema of the file and where its training stands. Reading it needs no torch."""

import json
import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictFloat, StrictInt, ValidationError

from uavaou.algorithms.io.tensor_file import CHECKSUM, ArrayFile
from uavaou.errors import InputError, all_faults
from uavaou.fields import NonNegative, Number, Whole, explain_validation
from uavaou.runs.folder import RunConfig, RunFolder

SCHEMA = 2  # 1 had no checksum; its policies are still read

ROWS_AN_EVALUATION = 50  # of progress.csv at most; learners that update every few slots would write millions

Count = Annotated[Whole, Field(ge=0, le=10**15)]

_FORMER = ("candidate", "candidate_score", "set_aside")  # fields of trainings in which the best of several went on

# What people read: `greedy` is the name of a planner too.
ACTIONS = {"greedy": "likeliest", "sample": "sampled"}


class TrainingProgress(BaseModel):
    """Where a training stands."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    slots: Count = 0  # of all missions together
    agent_steps: Count | None = None  # slots of UAVs; None: in files of earlier versions
    missions: Count = 0  # finished training missions, rows of episodes.csv
    recent: tuple[NonNegative, ...] = ()  # mean AoU of the last of them, s; those of a family do not end together
    wall_s: NonNegative = 0.0
    updates: Count = 0
    next_evaluation: Count = 0  # slots
    best_score: NonNegative | None = None  # mean AoU on the validation missions, s
    best_action: Literal["greedy", "sample"] = "greedy"  # the action that the best score was reached with
    rows: Count = 0  # of progress.csv
    row_slots: Count = 0  # slots at the last of them
    episodes_sha256: str | None = None  # of these rows of episodes.csv; None: in files of earlier versions
    progress_sha256: str | None = None
    figures: dict[str, StrictInt | StrictFloat] = {}  # logged since; may be nan
    budget_left: Number = 1.0  # the argument of SB3's schedules, from 1 to 0
    cpu_s: NonNegative | None = None  # of the training processes so far, playing and learning; None: not measured

    def fits(self, config: RunConfig, longest: int) -> str | None:
        """The first field that no training of ``config`` has at these ``slots``; None where all agree.

        Args:
            config: of the run.
            longest: slots from one update to the next, of all missions together.
        """
        algorithm, family, slots = config.algorithm, config.family, self.slots
        together = algorithm.missions
        intervals = {stage.evaluate_every_slots for stage in config.stages()}  # a larger budget may have a longer one
        every = max(intervals)
        steps = 0 if self.agent_steps is None else self.agent_steps
        uavs = (1, family.most[0]) if family else (config.scenario.uavs,) * 2  # the fewest and the most of a mission
        ended = slots // together // config.scenario.slots * together  # where all missions are equally long
        left = {1 - slots / algorithm.slots} | ({0.0} if config.budgets else set())  # 0: beyond
        agree = {
            "slots": slots % together == 0 and slots < config.slots + longest,
            "agent_steps": self.agent_steps is None or slots * uavs[0] <= steps <= slots * uavs[1],
            "missions": self.missions <= slots if family else self.missions == ended,
            "recent": len(self.recent) <= min(self.missions, together),
            "next_evaluation": self.next_evaluation in {(slots // one + 1) * one for one in intervals},
            "best_score": self.best_score is not None or slots < every,
            "row_slots": 0 <= slots - self.row_slots < max(every / ROWS_AN_EVALUATION, 1),
            "rows": (self.rows == 0) == (self.row_slots == 0) and self.rows <= slots,
            "budget_left": any(math.isclose(self.budget_left, one, abs_tol=1e-9) for one in left),
        }
        return next((name for name, holds in agree.items() if not holds), None)


def write_header(progress: TrainingProgress) -> dict[str, str]:
    """The text of a checkpoint's header."""
    return {"schema": str(SCHEMA), "progress": json.dumps(progress.model_dump())}


def open_policy(folder: RunFolder) -> tuple[ArrayFile, TrainingProgress]:
    """Open the policy of a run that is flown, and read where its training stood.

    Raises:
        InputError: there is none yet, it is lost, or its file cannot be read.
    """
    path = folder.policy
    none_yet = InputError(f"'{folder}' holds no checkpoint yet: its training has not reached the first one")
    if not path.is_file():
        raise none_yet
    file = ArrayFile(path)
    progress = read_header(file)
    if path == folder.last:
        if progress.slots == 0:
            raise none_yet
        if progress.best_score is not None:
            remedy = f"restore it, or copy {folder.last.name} in its place to fly the policy of slot {progress.slots:,}"
            raise InputError(f"{folder.best}: the best policy of '{folder}' is missing: {remedy}")
    return file, progress


def read_header(file: ArrayFile, oldest: int = 1) -> TrainingProgress:
    """Read where the training of a checkpoint stood.

    Args:
        file: the checkpoint.
        oldest: schema that is read.

    Raises:
        InputError: the file is no checkpoint of this software, or of a schema that is not read.
    """
    schema = file.text.get("schema", "")
    if not (schema.isascii() and schema.isdigit()):
        raise InputError(f"{file.path}: not a checkpoint of this software")
    if not oldest <= int(schema) <= SCHEMA:
        verb = "reads" if oldest == SCHEMA else "reads schemas 1 to"
        raise InputError(f"{file.path}: written with checkpoint schema {schema:.20}, this version {verb} {SCHEMA}")
    if int(schema) > 1 and CHECKSUM not in file.text:
        raise InputError(f"{file.path}: damaged: its checksum is missing")
    stated = file.json("progress")
    if isinstance(stated, dict):
        stated = {name: value for name, value in stated.items() if name not in _FORMER}
    try:
        return TrainingProgress.model_validate(stated)
    except ValidationError as error:
        reason = all_faults("progress", explain_validation(error, list(TrainingProgress.model_fields)))
        raise InputError(f"{file.path}: not a checkpoint of this software ({reason})") from None
