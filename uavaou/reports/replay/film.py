"""Missions as a film: the frames of the environment's ``rgb_array``, one a slot, as GIF or MP4."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from uavaou.envs.map import FRAME_SHAPE, UAV_COLOURS, age_scale, render_frame
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission
from uavaou.files import replacing, writing
from uavaou.reports.replay.page import check_one_mission

SLOTS_A_SECOND = 10
_LABEL_HEIGHT = 32  # pixels; a multiple of 16, as video encoders like it
_COLOURS = 128  # of a GIF
_UAV_SHADES = (1, 0.7, 0.4)  # of the colours of UAVs in it
_LAST_FRAME_S = 2  # how long a GIF stands still before it begins again


def check_format(format: str) -> None:
    """Refuse a format that this installation cannot write.

    Raises:
        InputError: it is ``mp4``, and PyAV is not installed.
    """
    if format != "mp4":
        return
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise InputError(f"--format mp4: '{error.name}' is not installed: pip install 'uavaou[video]'") from None


def write_film(
    path: Path, missions: Mapping[str, RecordedMission], format: str, slots: int | None = None
) -> Iterator[int]:
    """Write one mission as several policies flew it, side by side; yields each slot when its frame is drawn.

    The file is there when the iterator ends.

    Args:
        path: of the file.
        missions: label -> what the policy of that label did.
        format: ``gif``, or ``mp4``, which needs PyAV.
        slots: where the film ends, if that is before the end of the mission.

    Raises:
        InputError: the missions are not one mission, or the file cannot be written.
    """
    check_one_mission(missions)
    write = _write_gif if format == "gif" else _write_mp4
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            yield from write(file, missions, film_slots(missions, slots))


def film_slots(missions: Mapping[str, RecordedMission], slots: int | None = None) -> int:
    """The last slot of a film: the one wanted, or that of the mission where it ends before."""
    end = next(iter(missions.values())).scenario.slots
    return end if slots is None else min(slots, end)


def film_frame(missions: Mapping[str, RecordedMission], slot: int, last: int) -> NDArray[np.uint8]:
    """The maps of a slot in a row, each below the policy's label and its mean AoU so far, (H, W, 3).

    The colours run from a slot to the highest age of any device in the film, which ends with slot ``last``.
    """
    first = next(iter(missions.values()))
    highest = max(int(mission.age_slots[:last].max()) for mission in missions.values())
    scale = age_scale(first.scenario, first.recording.layout, [1, max(highest, 1)])
    columns = []
    for label, mission in missions.items():
        recording, snapshot = mission.recording, mission.snapshot(slot)
        drawn = render_frame(mission.scenario, recording.layout, snapshot, recording.positions, scale)
        so_far = mission.age_slots[:slot].sum(axis=1).mean()
        columns.append(np.vstack([_label(f"{label}: mean AoU so far {so_far:,.0f} slots"), drawn]))
    return np.hstack(columns)


def _label(text: str) -> NDArray[np.uint8]:
    """A strip with the text, as wide as a frame, (h, W, 3)."""
    strip = Image.new("RGB", (FRAME_SHAPE[1], _LABEL_HEIGHT), "white")
    font = ImageFont.load_default(22)
    ImageDraw.Draw(strip).text((strip.width / 2, _LABEL_HEIGHT - 4), text, "black", font, anchor="mb")
    return np.asarray(strip)


def _write_gif(file: Any, missions: Mapping[str, RecordedMission], last: int) -> Iterator[int]:
    palette, frames = _palette(film_frame(missions, last, last)), []
    for slot in range(1, last + 1):
        frame = Image.fromarray(film_frame(missions, slot, last))
        frames.append(frame.quantize(palette=palette, dither=Image.Dither.NONE))
        yield slot
    durations = [1000 // SLOTS_A_SECOND] * (last - 1) + [1000 * _LAST_FRAME_S]
    frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)


def _palette(frame: NDArray[np.uint8]) -> Image.Image:
    """One palette for all frames, so that none flickers: the colours of a frame, and those of UAVs and their trails.

    The lines of a UAV are too thin for the former to hold their colour.
    """
    colours = 255 * np.array([to_rgb(colour) for colour in UAV_COLOURS])  # (C, 3)
    shades = np.concatenate([255 + share * (colours - 255) for share in _UAV_SHADES]).round().astype(np.uint8)
    of_frame = Image.fromarray(frame).quantize(_COLOURS - len(shades)).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*of_frame[: 3 * (_COLOURS - len(shades))], *shades.ravel().tolist()])
    return palette


def _write_mp4(file: Any, missions: Mapping[str, RecordedMission], last: int) -> Iterator[int]:
    import av

    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=SLOTS_A_SECOND)
        stream.height, stream.width, _ = film_frame(missions, 1, last).shape
        stream.pix_fmt = "yuv420p"
        for slot in range(1, last + 1):
            picture = av.VideoFrame.from_ndarray(film_frame(missions, slot, last), format="rgb24")
            container.mux(stream.encode(picture))
            yield slot
        container.mux(stream.encode())
