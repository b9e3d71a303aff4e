"""The raw surface of a scan, as far as a robot comes near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from climbplan.robots.rotations import Array


@dataclass(frozen=True)
class RawSurface:
    """Triangles as they were scanned, turned to face free space."""

    vertices: Array  # (V, 3) [m]
    triangles: NDArray[np.int64]  # (T, 3) anticlockwise seen from free space
    flatness: float  # [m] largest distance of contact regions from it
    toe_radius: float  # [m] over which its normal is averaged at a toe

    @property
    def corners(self) -> Array:
        """(T, 3, 3) corners of the triangles [m]."""
        return self.vertices[self.triangles]
