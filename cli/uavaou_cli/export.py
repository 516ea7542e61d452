"""``uavaou export``: a trained run in the format of another tool, or for a computer on board."""

from pathlib import Path
from typing import Annotated, Any

from uavaou.errors import InputError
from uavaou.files import replacing, writing
from uavaou_cli.options import RunName, choice, option, writable_file, writable_folder
from uavaou_cli.tables import show

_FORMATS = "safetensors: for LEARNER.load; sb3: Stable-Baselines3's zip; onnx: a folder for a computer on board."


def export(
    run: RunName,
    out: Annotated[Path, option("The file to write; of onnx, the folder.", "FILE|DIR")],
    format: Annotated[str, choice(_FORMATS, "safetensors", "sb3", "onnx")] = "safetensors",
    scenario: Annotated[
        str | None, option("onnx: a preset, or a YAML file, of the map to fly. [default: the one trained on]")
    ] = None,
) -> None:
    """Write the best policy of a run for another tool.

    The folder of onnx holds the network with its masks, the map, and a program that flies a UAV by them without torch
    and without uavaou (docs/how-to/export.md).

    The zip of Stable-Baselines3 contains pickles. Loading a pickle runs the code in it, so load only files that you
    trust. uavaou itself reads none.
    """
    if format == "onnx":
        _export_onnx(run, out, scenario)
        return
    if scenario is not None:
        raise InputError("--scenario: --format onnx alone writes a map")
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
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        if format == "safetensors":
            model.save(out)
        else:
            with replacing(out, "wb") as file:  # a zip that was begun would be taken for a policy
                (model.save_sb3 if ours else model.save)(file)
    print(out)


def _export_onnx(run: str, out: Path, scenario: str | None) -> None:
    writable_folder(out)
    from uavaou.onboard.export import export_onnx

    exported = export_onnx(run, out, scenario)
    print(f"compared with torch: {exported.same:,} of {exported.rows:,} rows have the same action")
    show(exported.files)
