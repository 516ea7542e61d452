"""``uavaou export``: a trained run in the format of another tool."""

from pathlib import Path
from typing import Annotated, Any

from uavaou.errors import InputError
from uavaou.files import writing
from uavaou_cli.options import RunName, choice, option, writable_file


def export(
    run: RunName,
    out: Annotated[Path, option("The file to write.", "FILE")],
    format: Annotated[
        str, choice("safetensors: for LEARNER.load; sb3: Stable-Baselines3's zip.", "safetensors", "sb3")
    ] = "safetensors",
) -> None:
    """Write the best policy of a run as one file.

    The zip of Stable-Baselines3 contains pickles. Loading a pickle runs the code in it, so load only files that you
    trust. uavaou itself reads none.
    """
    if format == "sb3" and out.suffix != ".zip":
        raise InputError(f"--out {out}: a file for Stable-Baselines3 ends in .zip")
    writable_file(out)
    from uavaou.runs.folder import RunFolder
    from uavaou.runs.policy import load_run

    folder = RunFolder.at(run)
    model: Any = load_run(folder).model
    ours = hasattr(model, "save_sb3")
    if format == "safetensors" and not ours:
        raise InputError(f"'{run}': a {type(model).__name__} has no format but its own: --format sb3")
    write = model.save_sb3 if ours and format == "sb3" else model.save
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        write(out)
    print(out)
