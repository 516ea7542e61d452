"""``uavaou runs``: the trainings below a folder, what each changed, and what it has reached."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from uavaou.errors import InputError
from uavaou_cli.options import Results
from uavaou_cli.tables import aligned, show, wrapped

if TYPE_CHECKING:
    from uavaou.runs.folder import RunFolder

_HEAD = ("run", "slots", "mean AoU", "state")


def runs(out: Results = Path("results")) -> None:
    """List the trainings below a folder of results: what each changed, and what it has reached.

    The mean AoU is that of the best policy so far, in slots, on validation missions.
    """
    from uavaou.runs.folder import RunFolder

    folders = [RunFolder(path.parent) for path in sorted(out.glob("*/*/seed-*/config.yaml"))]
    if not folders:
        raise InputError(f"'{out}' holds no training: expected folders such as {out / 'paper' / 'mappo' / 'seed-0'}")
    rows, words = [_HEAD], [""]
    for folder in folders:
        cells, changed = _told(folder)
        rows.append((str(folder.path), *cells))
        words.append(changed)
    for line, changed in zip(aligned(rows), words, strict=True):
        show([line, *wrapped(changed, indent="  ")])


def _told(folder: RunFolder) -> tuple[tuple[str, str, str], str]:
    """The slots, the mean AoU and the state of a run, and what it changed."""
    from uavaou.runs.lock import holder
    from uavaou.runs.names import changes

    try:
        config = folder.read_config()
        changed = ", ".join(f"{field}={value}" for field, value in changes(config).items())
    except InputError as problem:
        return ("", "", "damaged"), str(problem)
    state = "running" if holder(folder.lock) is not None else "begun"
    try:
        meta = folder.read_meta()
    except InputError:
        return ("", "", state), changed
    if state == "begun":
        state = "finished" if meta.finished else "stopped"
    aou = "" if meta.best_score is None else f"{meta.best_score / config.scenario.slot_length_s:.2f}"
    return (f"{meta.slots:,}", aou, state), changed
