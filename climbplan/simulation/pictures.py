"""Pictures of a run, rendered off screen where the machine can (EGL or OSMesa)."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from climbplan.arrays import Array
from climbplan.simulation.mujoco_loading import load_mujoco

WIDTH, HEIGHT = 480, 640  # [pixels]
STRIP = 8  # pictures side by side
FRAMES = 1 + 8 * (STRIP - 1)  # of the film, those of the strip among them
_FILM_WIDTH = 300  # [pixels]
_FRAME_TIME = 120  # [ms]

Picture = NDArray[np.uint8]
Decorate = Callable[[Any, Any, Any], None]
"""Adds what a model has no geoms for to a scene: called with MuJoCo, scene and data."""


def open_camera(
    path: Array, *, azimuth: float = 105.0, follow: bool = False, decorate: Decorate | None = None
) -> SnapshotCamera | str:
    """Return a camera on a body that moves along a path (T, 3), or why none can be had.

    follow: it moves along; otherwise it sees all of the path from one place.
    """
    mujoco = load_mujoco()
    try:
        return SnapshotCamera(mujoco, path, azimuth, follow, decorate)
    except Exception as error:  # graphics libraries raise errors of many kinds
        hint = "install EGL or OSMesa (libegl1, libosmesa6) for off-screen drawing"
        return f"no pictures: {type(error).__name__}: {error}; {hint}"


class SnapshotCamera:
    """Takes pictures at evenly spaced samples of the trajectory."""

    def __init__(
        self, mujoco: Any, path: Array, azimuth: float, follow: bool, decorate: Decorate | None
    ) -> None:
        self.mujoco = mujoco
        self.samples = np.linspace(0, len(path) - 1, FRAMES).round().astype(int).tolist()
        self.pictures: list[tuple[int, Picture]] = []
        self._decorate = decorate
        self._follow = path if follow else None
        self._renderer: Any = None
        # A first drawing tells whether there is a graphics backend at all.
        probe = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
        mujoco.Renderer(probe, 8, 8).close()
        self.view = mujoco.MjvCamera()
        self.view.lookat[:] = (path.min(axis=0) + path.max(axis=0)) / 2
        span = 0.0 if follow else float(np.ptp(path, axis=0).max())
        self.view.distance = 1.3 if follow else 2.2 + 0.9 * span
        self.view.azimuth, self.view.elevation = azimuth, -12.0

    def watch(self, sample: int, model: Any, data: Any) -> None:
        """Take a picture if one is due."""
        if sample not in self.samples:
            return
        if self._renderer is None:
            self._renderer = self.mujoco.Renderer(model, HEIGHT, WIDTH)
        if self._follow is not None:
            self.view.lookat[:2] = self._follow[sample, :2]
        self._renderer.update_scene(data, self.view)
        if self._decorate is not None:
            self._decorate(self.mujoco, self._renderer.scene, data)
        self.pictures.append((sample, self._renderer.render().copy()))

    @property
    def strip(self) -> list[tuple[int, Picture]]:
        """The pictures to be seen side by side; of a run that ended early its last one as well."""
        due = self.samples[:: (FRAMES - 1) // (STRIP - 1)]
        chosen = [picture for picture in self.pictures if picture[0] in due]
        if self.pictures and chosen[-1][0] != self.pictures[-1][0]:
            chosen.append(self.pictures[-1])
        return chosen

    def film(self) -> bytes:
        """Return all pictures as an animated GIF."""
        size = (_FILM_WIDTH, round(_FILM_WIDTH * HEIGHT / WIDTH))
        frames = [
            Image.fromarray(image).resize(size).quantize(96, dither=Image.Dither.NONE)
            for _, image in self.pictures
        ]
        with io.BytesIO() as stream:
            frames[0].save(
                stream, "GIF", save_all=True, append_images=frames[1:], loop=0, optimize=True,
                duration=[_FRAME_TIME] * (len(frames) - 1) + [12 * _FRAME_TIME],
            )  # fmt: skip
            return stream.getvalue()

    def close(self) -> None:
        """Give the graphics memory back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
