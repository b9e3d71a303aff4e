"""Pictures of a run, rendered off screen where the machine can (EGL or OSMesa)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.simulation.replay import load_mujoco

WIDTH, HEIGHT = 480, 640  # [pixels]
FRAMES = 8

Picture = NDArray[np.uint8]


def open_camera(plan: ClimbPlan) -> Camera | str:
    """A camera on the scene, or why none can be had."""
    mujoco = load_mujoco()
    try:
        return Camera(mujoco, plan)
    except Exception as error:  # graphics libraries raise errors of many kinds
        return f"no pictures: {type(error).__name__}: {error}"


class Camera:
    """Takes pictures at evenly spaced samples of the trajectory."""

    def __init__(self, mujoco: Any, plan: ClimbPlan) -> None:
        self.mujoco = mujoco
        self.samples = set(
            np.linspace(0, len(plan.trajectory.time) - 1, FRAMES).round().astype(int).tolist()
        )
        self.pictures: list[tuple[int, Picture]] = []
        self._renderer: Any = None
        self._of: Any = None
        # A first drawing tells whether there is a graphics backend at all.
        probe = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
        mujoco.Renderer(probe, 8, 8).close()
        com = plan.trajectory.com
        self.view = mujoco.MjvCamera()
        self.view.lookat[:] = (com.min(axis=0) + com.max(axis=0)) / 2
        self.view.distance = 1.7 + 1.0 * float(np.ptp(com[:, 2]))
        self.view.azimuth, self.view.elevation = 105.0, -12.0

    def watch(self, sample: int, model: Any, data: Any) -> None:
        """Take a picture if one is due."""
        if sample not in self.samples:
            return
        if self._renderer is None:
            self._renderer = self.mujoco.Renderer(model, HEIGHT, WIDTH)
        self._renderer.update_scene(data, self.view)
        self.pictures.append((sample, self._renderer.render().copy()))

    def close(self) -> None:
        """Give the graphics memory back."""
        if self._renderer is not None:
            self._renderer.close()


Watch = Callable[[int, Any, Any], None]
