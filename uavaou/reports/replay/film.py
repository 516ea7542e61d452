"""Missions as a film: the frames of the environment's ``rgb_array``, one a slot, as GIF or MP4."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from uavaou.envs.map import FRAME_SHAPE, render_frame
from uavaou.errors import InputError
from uavaou.evaluation.recorded_mission import RecordedMission
from uavaou.files import replacing, writing
from uavaou.reports.replay.page import check_one_mission

SLOTS_A_SECOND = 10
_LABEL_HEIGHT = 32  # pixels; a multiple of 16, as video encoders like it
_COLOURS = 128  # of a GIF
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


def write_film(path: Path, missions: Mapping[str, RecordedMission], format: str) -> Iterator[int]:
    """Write one mission as several policies flew it, side by side; yields each slot when its frame is drawn.

    The file is there when the iterator ends.

    Args:
        path: of the file.
        missions: label -> what the policy of that label did.
        format: ``gif``, or ``mp4``, which needs PyAV.

    Raises:
        InputError: the missions are not one mission, or the file cannot be written.
    """
    check_one_mission(missions)
    write = _write_gif if format == "gif" else _write_mp4
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, "wb") as file:
            yield from write(file, missions)


def film_frame(missions: Mapping[str, RecordedMission], slot: int) -> NDArray[np.uint8]:
    """The maps of a slot in a row, each below the policy's label, (H, W, 3)."""
    return np.hstack([np.vstack([_label(label), _map(mission, slot)]) for label, mission in missions.items()])


def _map(mission: RecordedMission, slot: int) -> NDArray[np.uint8]:
    recording = mission.recording
    return render_frame(mission.scenario, recording.layout, mission.snapshot(slot), recording.positions)


def _label(text: str) -> NDArray[np.uint8]:
    """A strip with the label, as wide as a frame, (h, W, 3)."""
    strip = Image.new("RGB", (FRAME_SHAPE[1], _LABEL_HEIGHT), "white")
    font = ImageFont.load_default(18)
    ImageDraw.Draw(strip).text((strip.width / 2, _LABEL_HEIGHT - 4), text, "black", font, anchor="mb")
    return np.asarray(strip)


def _write_gif(file: Any, missions: Mapping[str, RecordedMission]) -> Iterator[int]:
    slots = next(iter(missions.values())).scenario.slots
    palette = Image.fromarray(film_frame(missions, slots)).quantize(
        _COLOURS
    )  # one for all frames, so that none flickers
    frames = []
    for slot in range(1, slots + 1):
        frame = Image.fromarray(film_frame(missions, slot))
        frames.append(frame.quantize(palette=palette, dither=Image.Dither.NONE))
        yield slot
    durations = [1000 // SLOTS_A_SECOND] * (slots - 1) + [1000 * _LAST_FRAME_S]
    frames[0].save(file, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)


def _write_mp4(file: Any, missions: Mapping[str, RecordedMission]) -> Iterator[int]:
    import av

    slots = next(iter(missions.values())).scenario.slots
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=SLOTS_A_SECOND)
        stream.height, stream.width, _ = film_frame(missions, 1).shape
        stream.pix_fmt = "yuv420p"
        for slot in range(1, slots + 1):
            picture = av.VideoFrame.from_ndarray(film_frame(missions, slot), format="rgb24")
            container.mux(stream.encode(picture))
            yield slot
        container.mux(stream.encode())
