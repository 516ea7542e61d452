"""What a checkpoint states: where its training stands. Reading it needs no torch."""

from typing import Any, ClassVar, Literal

from pydantic import Field

from uavaou.algorithms.io.tensor_file import ArrayFile, Header
from uavaou.errors import InputError
from uavaou.runs.folder import RunFolder

ROWS_AN_EVALUATION = 50  # of progress.csv at most; learners that update every few slots would write millions

# What people read: `greedy` is the name of a planner too.
ACTIONS = {"greedy": "likeliest", "sample": "sampled"}


class TrainingProgress(Header):
    """Where a training stands."""

    entry: ClassVar[str] = "progress"

    slots: int = 0  # of all missions together
    agent_steps: int | None = None  # slots of UAVs; None: in files of earlier versions
    missions: int = 0  # finished training missions, rows of episodes.csv
    recent: tuple[float, ...] = ()  # mean AoU of the last of them, s; those of a family do not end together
    wall_s: float = 0.0
    updates: int = 0
    next_evaluation: int = 0  # slots
    best_score: float | None = None  # mean AoU on the validation missions, s
    best_action: Literal["greedy", "sample"] = "greedy"  # the action that the best score was reached with
    rows: int = 0  # of progress.csv
    row_slots: int = 0  # slots at the last of them
    episodes_sha256: str | None = None  # of these rows of episodes.csv; None: in files of earlier versions
    progress_sha256: str | None = None
    figures: dict[str, int | float] = Field(default_factory=dict)  # logged since; may be nan
    budget_left: float = 1.0  # the argument of SB3's schedules, from 1 to 0
    cpu_s: float | None = None  # of the training processes so far, playing and learning; None: not measured

    # Of earlier versions, in which the best of several trainings went on; read, and not written.
    candidate: Any = Field(default=None, exclude=True)
    candidate_score: Any = Field(default=None, exclude=True)
    set_aside: Any = Field(default=None, exclude=True)


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
    progress = TrainingProgress.read(file)
    if path == folder.last:
        if progress.slots == 0:
            raise none_yet
        if progress.best_score is not None:
            remedy = f"restore it, or copy {folder.last.name} in its place to fly the policy of slot {progress.slots:,}"
            raise InputError(f"{folder.best}: the best policy of '{folder}' is missing: {remedy}")
    return file, progress
