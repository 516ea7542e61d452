"""What a checkpoint's header says: the schema of the file and where its training stands. Reading it needs no torch."""

import json
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StrictFloat, StrictInt, ValidationError, model_validator

from uavaou.algorithms.io.tensor_file import CHECKSUM, ArrayFile
from uavaou.errors import InputError
from uavaou.fields import Number, Whole, explain_validation
from uavaou.runs.folder import RunFolder

SCHEMA = 2  # 1 had no checksum; its policies are still read

Count = Annotated[Whole, Field(ge=0, le=10**15)]


class TrainingProgress(BaseModel):
    """Where a training stands."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    slots: Count = 0  # of all missions together
    agent_steps: Count | None = None  # slots of UAVs; None: in files of earlier versions
    missions: Count = 0  # finished training missions, rows of episodes.csv
    recent: tuple[Number, ...] = ()  # mean AoU of the last of them, s; those of a family do not end together
    wall_s: Number = 0.0
    updates: Count = 0
    next_evaluation: Count = 0  # slots
    best_score: Number | None = None  # mean AoU on the validation missions, s
    best_action: Literal["greedy", "sample"] = "greedy"  # the action that the best score was reached with
    rows: Count = 0  # of progress.csv
    row_slots: Count = 0  # slots at the last of them
    figures: dict[str, StrictInt | StrictFloat] = {}  # logged since; may be nan
    budget_left: Number = 1.0  # the argument of SB3's schedules, from 1 to 0
    cpu_s: Number | None = None  # of the training processes so far, playing and learning; None: not measured

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if self.row_slots > self.slots:
            raise ValueError(f"row_slots = {self.row_slots}: expected at most slots = {self.slots}")
        return self


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
    try:
        return TrainingProgress.model_validate(file.json("progress"))
    except ValidationError as error:
        reason = explain_validation(error, list(TrainingProgress.model_fields))
        raise InputError(f"{file.path}: not a checkpoint of this software (progress: {reason})") from None
