"""The raw surface of a scan, as far as a robot comes near it, and what limbs keep from it.

A limb's links keep their radius r from all of it, each capsule its own. The last 5 cm along the
axis of a last link's capsule, with the way from its end to the toe, narrow to the toe: of these the
axis alone has to miss it, and the tip may touch where it stands, as nearly as regions lie. Only
from the surface that its toe stands on, or is just lifted from or set down on, does a limb keep
less: a point of its axis at distance d from where the toe stands keeps

    min(r, d / 4 - flatness),

so that a limb is a cone of 14 degrees there, and from 4 (r + flatness) on it keeps its whole radius
from that surface, too. A limb that lies along its wall never does. That surface are triangles
which face as the contact does, within 60 degrees, and whose place nearest to it rises above its
plane by no more than 30 degrees: neither a rib beside the toe nor a ledge above is part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array, IntArray

NARROW = 0.05  # [m] last part of a limb, which narrows to its toe
SLENDER = 0.25  # room of a limb's axis at its contact, by the distance from it
FACING = 0.5  # cosine to the contact's normal of the surface that it is on
RISING = 0.5773502691896258  # tangent of the slope to where that surface may rise


@dataclass(frozen=True)
class RawSurface:
    """Triangles as they were scanned, turned to face free space."""

    vertices: Array  # (V, 3) [m]
    triangles: IntArray  # (T, 3) anticlockwise seen from free space
    flatness: float  # [m] largest distance of contact regions from it
    toe_radius: float  # [m] over which its normal is averaged at a toe
    finger_depth: float = 0.0  # [m] that fingers reach beside what they grip; 0: nothing is gripped

    @property
    def corners(self) -> Array:
        """(T, 3, 3) corners of the triangles [m]."""
        return self.vertices[self.triangles]
