"""Stills and films of plans, small enough for pages: what `climbplan report --film` draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from climbplan.api.kinds import identify_kind
from climbplan.exports.film import schedule_frames
from climbplan.exports.film_frames import Frames

# Of a frame of 1280 x 720: the bands with words above and below are cut off [pixels]
FRAME_BOX = (0, 88, 1280, 666)
CARD_SIZE = (400, 250)
MAX_STILL_BYTES = 20_000
MIN_FRAMES = 40
END_DURATION = 1500  # [ms] that the end of a film stands


def draw_plan(path: Path, fraction: float = 0.5) -> Image.Image:
    """Return a frame of a plan at a fraction of its time; raises UsageError if nothing moves."""
    scene = identify_kind(path).read_scene(path)
    time = float(scene.time[0] + fraction * (scene.time[-1] - scene.time[0]))
    with Frames(scene) as frames:
        return Image.fromarray(frames.render_at(time)).crop(FRAME_BOX)


def write_card_picture(picture: Image.Image, target: Path) -> Path:
    """Write the middle of a picture in the size of a card, in at most `MAX_STILL_BYTES`."""
    width = min(picture.width, round(picture.height * CARD_SIZE[0] / CARD_SIZE[1]))
    left = (picture.width - width) // 2
    middle = picture.crop((left, 0, left + width, picture.height))
    small = middle.resize(CARD_SIZE, Image.Resampling.LANCZOS)
    for quality in (80, 70, 60, 50, 40):
        small.save(target, quality=quality, method=6)
        if target.stat().st_size <= MAX_STILL_BYTES:
            return target
    raise ValueError(f"{target}: more than {MAX_STILL_BYTES} bytes")


def write_film(plan: Path, target: Path, width: int, rate: float) -> Path:
    """Write a film (.webp) of a plan, paced as `climbplan report --film` paces it.

    Motions of less than `MIN_FRAMES` are shown in slow motion.

    Args:
        plan: The plan file.
        target: The film.
        width: Of its frames [pixels].
        rate: Frames a second [Hz].
    """
    scene = identify_kind(plan).read_scene(plan)
    times = schedule_frames(scene.time[[0, -1]], scene.time[scene.marks], rate)
    if len(times) < MIN_FRAMES:
        times = np.linspace(scene.time[0], scene.time[-1], MIN_FRAMES)
    height = round(width * (FRAME_BOX[3] - FRAME_BOX[1]) / (FRAME_BOX[2] - FRAME_BOX[0]))
    pictures = []
    with Frames(scene) as frames:
        for time in times:
            picture = Image.fromarray(frames.render_at(float(time))).crop(FRAME_BOX)
            pictures.append(picture.resize((width, height), Image.Resampling.LANCZOS))
    durations = [round(1000 / rate)] * (len(pictures) - 1) + [END_DURATION]
    pictures[0].save(
        target, save_all=True, append_images=pictures[1:], loop=0, duration=durations,
        quality=40, method=5,
    )  # fmt: skip
    return target
