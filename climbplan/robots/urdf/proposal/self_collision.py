"""Self-collision test of a robot by the URDF's own collision geometry (coal)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.robots.urdf.canonical_urdf import write_canonical_urdf
from climbplan.robots.urdf.pinocchio_model import UrdfModel

_NUM_SAMPLES = 40  # postures that show which pairs always touch
_ALWAYS_RATIO = 0.8  # of these, in which a pair touches


@dataclass(frozen=True)
class SelfCollisionModel:
    """Collision geometry of a robot, and the pairs of parts that are tested."""

    urdf_model: UrdfModel
    geometry: Any
    permanent_pairs: tuple[tuple[str, str], ...]  # that touch in nearly all postures: not tested

    def find_collisions(self, angles: dict[str, float]) -> list[tuple[str, str]]:
        """Return pairs of parts that touch at joint angles by name [rad].

        Other joints are locked or at zero.
        """
        pin, model = self.urdf_model.library, self.urdf_model.model
        data, shapes = model.createData(), self.geometry.createData()
        pin.computeCollisions(
            model, data, self.geometry, shapes, self.urdf_model.build_configuration(angles), False
        )
        items = self.geometry.geometryObjects
        return [
            (items[pair.first].name, items[pair.second].name)
            for pair, result in zip(
                self.geometry.collisionPairs, shapes.collisionResults, strict=True
            )
            if result.isCollision()
        ]


def build_self_collision_model(
    urdf_model: UrdfModel, bounds: dict[str, tuple[float, float]]
) -> SelfCollisionModel:
    """Build the model with all pairs but neighbours and those that touch in most postures.

    Neighbours are parts of one body and of bodies that one joint connects.

    Args:
        urdf_model: The robot, with meshes.
        bounds: Joint bounds by name [rad], within which postures are sampled.
    """
    pin, model = urdf_model.library, urdf_model.model
    geometry = pin.buildGeomFromUrdfString(
        model, write_canonical_urdf(urdf_model.robot), pin.GeometryType.COLLISION
    )
    items = geometry.geometryObjects
    for first in range(len(items)):
        for second in range(first + 1, len(items)):
            a, b = items[first].parentJoint, items[second].parentJoint
            if a != b and model.parents[a] != b and model.parents[b] != a:
                geometry.addCollisionPair(pin.CollisionPair(first, second))
    untested = SelfCollisionModel(urdf_model, geometry, ())
    samples = np.random.default_rng(0).random((_NUM_SAMPLES, len(bounds)))
    counts: dict[tuple[str, str], int] = {}
    for sample in samples:
        angles = {
            joint: low + float(s) * (high - low)
            for s, (joint, (low, high)) in zip(sample, bounds.items(), strict=True)
        }
        for pair in untested.find_collisions(angles):
            counts[pair] = counts.get(pair, 0) + 1
    permanent = tuple(
        pair for pair, count in counts.items() if count >= _ALWAYS_RATIO * _NUM_SAMPLES
    )
    index = {item.name: number for number, item in enumerate(items)}
    for first_part, second_part in permanent:
        geometry.removeCollisionPair(pin.CollisionPair(index[first_part], index[second_part]))
    return SelfCollisionModel(urdf_model, geometry, permanent)
