"""The raw surface of a scan near a robot, and the clearance of limbs from it.

Each capsule of a limb's links keeps its radius r from all of the surface. The last 5 cm along the
axis of a last link's capsule, extended from its end to the toe, taper to the toe. There the axis
alone has to miss the surface, and the tip may touch where it stands, within the flatness of
regions. Only from the surface that its toe stands on, or is just lifted from or placed on, does a
limb keep less: a point of its axis at distance d from the contact keeps

    min(r, d / 4 - flatness),

so that a limb is a cone of 14 degrees there. From 4 (r + flatness) on it keeps its whole radius
from that surface, too. A limb that lies along its wall never does. The surface of a contact
consists of triangles that face as the contact does, within 60 degrees, and whose nearest point
rises above its plane by no more than 30 degrees: neither a rib beside the toe nor a ledge above is
part of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from climbplan.arrays import Array, IntArray

NARROW = 0.05  # [m] last part of a limb, which tapers to its toe
SLENDER = 0.25  # clearance of a limb's axis at its contact, over the distance from it
FACING = 0.5  # cosine to the contact's normal of the surface that it is on
RISING = 0.5773502691896258  # tangent of the slope by which that surface may rise


@dataclass(frozen=True)
class RawSurface:
    """Scanned triangles, oriented towards free space."""

    vertices: Array  # (V, 3) [m]
    triangles: IntArray  # (T, 3) anticlockwise seen from free space
    flatness: float  # [m] largest distance of contact regions from it
    toe_radius: float  # [m] over which its normal is averaged at a toe
    finger_depth: float = 0.0  # [m] that fingers reach beside what they grip; 0: nothing is gripped

    @cached_property
    def corners(self) -> Array:
        """Corners (T, 3, 3) of the triangles [m]."""
        return self.vertices[self.triangles]

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates (T, 3) of the triangles [m]."""
        return self.corners.min(axis=1), self.corners.max(axis=1)

    def find_triangles_in(self, low: Array, high: Array) -> IntArray:
        """Return the triangles (K,) whose boxes overlap a box with corners (3,) [m]."""
        lowest, highest = self.boxes
        return np.flatnonzero(((lowest <= high) & (highest >= low)).all(axis=1))
