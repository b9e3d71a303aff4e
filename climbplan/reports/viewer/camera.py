"""Where to look at a scene from, so that what moves is seen."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from climbplan.arrays import Array
from climbplan.reports.viewer.scene import Solids, ViewerScene, interpolate

_SAMPLES = 400  # of the way that a camera follows
_LAG = 0.04  # of it, over which the way is smoothed


def measure_moving_parts(scene: ViewerScene) -> tuple[Array, float]:
    """Return the middle of what moves (F, 3), and its largest extent at any time [m]."""
    points = []
    if scene.rods is not None:
        points.append(scene.rods.ends.reshape(len(scene.time), -1, 3))
    if scene.boxes is not None:
        is_shown = scene.boxes.size.any(axis=-1, keepdims=True)
        points.append(np.where(is_shown, scene.boxes.center, np.nan))
    if scene.solids is not None:
        points.append(_compute_corners(scene.solids))
    if not points:
        middle = np.tile((scene.lower + scene.upper) / 2, (len(scene.time), 1))
        return middle, float(np.linalg.norm(scene.upper - scene.lower))
    everything = np.concatenate(points, axis=1)
    low, high = np.nanmin(everything, axis=1), np.nanmax(everything, axis=1)
    return (low + high) / 2, float(np.linalg.norm(high - low, axis=1).max())


def _compute_corners(solids: Solids) -> Array:
    """Return corners (F, 8 K, 3) of the solids' own boxes."""
    ends = [np.stack([v.min(axis=0), v.max(axis=0)]) for v in solids.vertices]
    local_corners = np.stack([np.stack(np.meshgrid(*e.T), axis=-1).reshape(8, 3) for e in ends])
    world_corners = solids.position[:, :, None] + np.einsum(
        "fkij,kcj->fkci", solids.rotation, local_corners
    )
    corners: Array = world_corners.reshape(len(world_corners), -1, 3)
    return corners


def compute_camera_path(scene: ViewerScene, middle: Array, time: Array) -> Array:
    """Return where a camera looks at times (T,) that follows the middle of what moves: (T, 3),
    smooth.

    Repeated times are jumps, over which it moves on evenly.
    """
    uniform_time = np.linspace(scene.time[0], scene.time[-1], _SAMPLES)
    targets = np.stack([interpolate(middle, scene.moment(float(t))) for t in uniform_time])
    smooth = gaussian_filter1d(targets, _LAG * _SAMPLES, axis=0, mode="nearest")
    return np.stack([np.interp(time, uniform_time, smooth[:, axis]) for axis in range(3)], axis=-1)
