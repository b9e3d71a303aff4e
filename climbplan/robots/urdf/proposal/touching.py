"""Whether parts of a robot touch one another, by the URDF's own collision geometry (coal)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.robots.urdf.normal_document import normal_document
from climbplan.robots.urdf.pinocchio_model import UrdfModel

_DRAWN = 40  # postures that tell pairs which always touch
_ALWAYS = 0.8  # share of these


@dataclass(frozen=True)
class Parts:
    """Collision geometry of a robot, and the pairs of parts that may touch or not."""

    found: UrdfModel
    geometry: Any
    always: tuple[tuple[str, str], ...]  # parts that touch however the robot stands: left out

    def touching(self, angles: dict[str, float]) -> list[tuple[str, str]]:
        """Pairs of parts that touch at joint angles by name [rad]; others are locked or at zero."""
        pin, model = self.found.library, self.found.model
        data, shapes = model.createData(), self.geometry.createData()
        pin.computeCollisions(model, data, self.geometry, shapes, self.found.angles(angles), False)
        items = self.geometry.geometryObjects
        return [
            (items[pair.first].name, items[pair.second].name)
            for pair, result in zip(
                self.geometry.collisionPairs, shapes.collisionResults, strict=True
            )
            if result.isCollision()
        ]


def parts_of(found: UrdfModel, bounds: dict[str, tuple[float, float]]) -> Parts:
    """All pairs but neighbours, and those that touch in most postures within bounds [rad].

    found: with meshes. Neighbours are parts of one body and of bodies that one joint connects.
    """
    pin, model = found.library, found.model
    geometry = pin.buildGeomFromUrdfString(
        model, normal_document(found.robot), pin.GeometryType.COLLISION
    )
    items = geometry.geometryObjects
    for first in range(len(items)):
        for second in range(first + 1, len(items)):
            a, b = items[first].parentJoint, items[second].parentJoint
            if a != b and model.parents[a] != b and model.parents[b] != a:
                geometry.addCollisionPair(pin.CollisionPair(first, second))
    parts = Parts(found, geometry, ())
    drawn = np.random.default_rng(0).random((_DRAWN, len(bounds)))
    counts: dict[tuple[str, str], int] = {}
    for share in drawn:
        angles = {
            joint: low + float(s) * (high - low)
            for s, (joint, (low, high)) in zip(share, bounds.items(), strict=True)
        }
        for pair in parts.touching(angles):
            counts[pair] = counts.get(pair, 0) + 1
    always = tuple(pair for pair, count in counts.items() if count >= _ALWAYS * _DRAWN)
    index = {item.name: number for number, item in enumerate(items)}
    for one, other in always:
        geometry.removeCollisionPair(pin.CollisionPair(index[one], index[other]))
    return Parts(found, geometry, always)
