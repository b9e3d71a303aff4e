"""A plan's motion as a film and a still: GIF or WebP, and MP4 where its encoder is there.

MuJoCo draws the scene of `climbplan view`, frame by frame where the plan puts it: this is what was
planned, not a simulation. Walls are seen through, so that legs behind them are seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from climbplan.arrays import Array
from climbplan.errors import MissingSolver, UsageError
from climbplan.exports.film_frames import HEIGHT, WIDTH, Frames
from climbplan.reports.viewer.scene import ViewerScene
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.pictures import Picture
from climbplan.store.atomic_file import replace_atomically

LONGEST = 12.0  # [s] of a film; what goes on for long in a longer plan is played faster
_STILL = 1.5  # [s] that the end stands
_COLORS = 96  # of a GIF


@dataclass(frozen=True)
class _Kind:
    """A kind of film, by the ending of its name."""

    rate: float  # [Hz]; GIF counts hundredths of a second
    write: Callable[[Iterator[Picture], Path, float], None]


def check_film(path: Path) -> None:
    """Raise an error if no film can be written to a file, before anything is drawn.

    Raises:
        UsageError: The name ends in none of .gif, .webp and .mp4.
        MissingSolver: MuJoCo or, for MP4, its encoder is missing.
    """
    kind = _select_kind(path)
    load_mujoco("a film", "film")
    if kind.write is _write_mp4:
        _load_encoder()


def write_film(
    scene: ViewerScene,
    path: Path,
    headline: str = "",
    progress: Callable[[float], None] = lambda part: None,
) -> Path:
    """Write a film of 1280 x 720, and a still of its middle as .png next to it.

    Args:
        scene: Scene of a plan, as the viewer shows it.
        path: File that ends in .gif, .webp or .mp4.
        headline: Text above, next to the scene's title.
        progress: Called with the fraction that is done.

    Returns:
        The path of the still.

    Raises:
        UsageError: The name ends otherwise, or nothing in the scene moves.
        MissingSolver: MuJoCo, a graphics backend or, for MP4, its encoder is missing.
    """
    kind = _select_kind(path)
    if len(scene.time) < 2 or not scene.time[-1] > scene.time[0]:
        raise UsageError(f"{scene.title}: expected a plan with a motion, nothing in it moves")
    times = schedule_frames(scene.time[[0, -1]], scene.time[scene.marks], kind.rate)
    still_path = path.with_suffix(".png")
    middle = len(times) // 2
    with Frames(scene, headline) as frames:

        def draw_frames() -> Iterator[Picture]:
            for number, time in enumerate(times):
                yield frames.render_at(float(time))
                progress((number + 1) / len(times))

        with replace_atomically(path) as temporary_path:
            kind.write(draw_frames(), temporary_path, kind.rate)
        with replace_atomically(still_path) as temporary_path:
            picture = Image.fromarray(frames.render_at(float(times[middle])))
            picture.quantize(192).save(temporary_path, "PNG", optimize=True)
    return still_path


def schedule_frames(ends: Array, marks: Array, rate: float) -> Array:
    """Return times of a plan [s] that are shown at a rate [Hz] one after the other.

    As time goes by where the plan takes no more than `LONGEST`. Otherwise none of the spans between
    marks lasts longer than makes all of them fit: long ones are played faster, short ones are not.
    """
    stops = np.unique(np.clip(np.concatenate([ends, marks]), ends[0], ends[1]))
    span = np.diff(stops)
    shown_spans = np.minimum(span, _compute_span_limit(span))
    film_clock = np.linspace(0.0, shown_spans.sum(), max(2, round(float(shown_spans.sum()) * rate)))
    times: Array = np.interp(film_clock, np.concatenate([[0.0], np.cumsum(shown_spans)]), stops)
    return times


def _compute_span_limit(span: Array) -> float:
    """Return the length to which spans are cut so that they take `LONGEST` together."""
    if span.sum() <= LONGEST:
        return float(span.max())
    remaining, count = LONGEST, len(span)
    for length in np.sort(span):
        if length * count >= remaining:
            return remaining / count
        remaining -= float(length)
        count -= 1
    return float(span.max())


def _select_kind(path: Path) -> _Kind:
    kinds = {
        ".gif": _Kind(12.5, _write_gif),
        ".webp": _Kind(12.5, _write_webp),
        ".mp4": _Kind(25.0, _write_mp4),
    }
    if path.suffix.lower() not in kinds:
        raise UsageError(f"{path}: expected a name that ends in .gif, .webp or .mp4")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: expected a file in a directory that exists")
    if path.suffix.lower() == ".mp4":
        _load_encoder()
    return kinds[path.suffix.lower()]


def _list_durations(count: int, rate: float) -> list[int]:
    """Return how long each picture stands [ms]."""
    return [round(1000 / rate)] * (count - 1) + [round(1000 * _STILL)]


def _write_gif(pictures: Iterator[Picture], path: Path, rate: float) -> None:
    # One palette for all: pictures that differ little then differ in few pixels
    images = [Image.fromarray(picture) for picture in pictures]
    sample_images = images[:: max(1, len(images) // 6)]
    sample = Image.fromarray(
        np.concatenate([np.asarray(image)[::2, ::2] for image in sample_images])
    )
    palette = sample.quantize(_COLORS)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    frames[0].save(
        path,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        loop=0,
        optimize=False,  # which would give each picture a palette of its own
        duration=_list_durations(len(frames), rate),
    )


def _write_webp(pictures: Iterator[Picture], path: Path, rate: float) -> None:
    images = [Image.fromarray(picture) for picture in pictures]
    lasting = _list_durations(len(images), rate)
    images[0].save(
        path,
        "WEBP",
        save_all=True,
        append_images=images[1:],
        loop=0,
        duration=lasting,
        quality=70,
        method=2,
    )


def _write_mp4(pictures: Iterator[Picture], path: Path, rate: float) -> None:
    writer = _load_encoder().write_frames(
        str(path), (WIDTH, HEIGHT), fps=rate, codec="libx264", quality=7, macro_block_size=16,
        output_params=["-f", "mp4"], ffmpeg_log_level="error",
    )  # fmt: skip
    writer.send(None)
    last: NDArray[np.uint8] | None = None
    try:
        for picture in pictures:
            last = np.ascontiguousarray(picture)
            writer.send(last)
        for _ in range(round(_STILL * rate)):
            writer.send(last)
    finally:
        writer.close()


def _load_encoder() -> Any:
    try:
        return import_module("imageio_ffmpeg")
    except ImportError as error:
        raise MissingSolver(
            "MP4 needs an encoder: pip install 'climbplan[film]'; .gif and .webp need none"
        ) from error
