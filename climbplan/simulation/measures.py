"""What runs in every engine are judged by: falls, slips, tilt, and toes that roll."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

FALLEN = 0.15  # [m] below where it should be
TUMBLED = np.deg2rad(45)  # away from where it should be

SLIP = 0.005  # [m] that a standing toe slides from where it was set down


def integrate_rolling(radius: float, links: Array, normal: Array) -> Array:
    """Return (S, 3) of the centre since the first of S samples [m].

    links: (S, 3, 3) of the foot's link to the world, little turned from one to the next; normal:
    (3,) of the surface. The point that touches stands still, so that the centre's velocity is that
    of the link's turning times the radius along the normal.
    """
    change = links[1:] @ np.swapaxes(links[:-1], -1, -2)
    skew_part = change - np.swapaxes(change, -1, -2)
    rotation_vector = (
        np.stack([skew_part[:, 2, 1], skew_part[:, 0, 2], skew_part[:, 1, 0]], axis=-1) / 2
    )
    displacement = np.cumsum(radius * np.cross(rotation_vector, normal), axis=0)
    return np.concatenate([np.zeros((1, 3)), displacement])


def compute_tilt(rotation: Array, planned: Array) -> Array:
    """Return angle (...) between rotations (..., 3, 3) [rad]."""
    cosine = (np.einsum("...ij,...ij->...", rotation, planned) - 1) / 2
    return np.arccos(np.clip(cosine, -1.0, 1.0))
