"""A draft of a robot section: what is known of the legs so far, loaded as any robot is."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from climbplan.errors import SpecError
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.shapes import CollisionShape, read_collision_shapes
from climbplan.schema.document import Document
from climbplan.schema.robots.source import build_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot


@dataclass
class Draft:
    """The keys of a robot section that is being assembled."""

    urdf: Path
    base: str
    legs: dict[str, dict[str, Any]]
    joints: dict[str, dict[str, float]]
    locked: dict[str, float]
    forward: str = "x"
    up: str = "z"
    packages: dict[str, str] = field(default_factory=dict)
    foot: float = 0.0  # radius of spherical feet [m]; 0: points
    sole: tuple[float, float] | None = None  # length and width of flat feet [m]
    missing_meshes: tuple[str, ...] = ()  # collision meshes without a file
    requested_toes: tuple[str, ...] = ()  # links that legs end in; empty: inferred

    def load_robot(self, meshes: bool = False) -> UrdfRobot:
        """Return the robot of the section.

        Args:
            meshes: Whether to read collision meshes; without them a nominal size stands for them.

        Raises:
            SpecError: The URDF is wrong.
        """
        section: dict[str, Any] = {
            "kind": "robot",
            "urdf": str(self.urdf),
            "base": self.base,
            "forward": self.forward,
            "up": self.up,
            "legs": self.legs,
            "joints": self.joints,
            "locked": self.locked,
            "packages": self.packages,
        }
        if self.missing_meshes:
            section["missing_meshes"] = "ignore"
        if self.foot:
            section["foot"] = {"radius": self.foot}
        if self.sole is not None:
            section["foot"] = dict(zip(("length", "width"), self.sole, strict=True))
        if not meshes:
            section |= {"limb_radius": 0.02, "body_half_size": [0.1, 0.1, 0.1]}
        document = Document(self.urdf.name, "", section)
        robot = build_robot(document, Path())
        if not isinstance(robot, UrdfRobot):
            raise TypeError(f"no robot from a URDF: {json.dumps(section)[:80]}")
        return robot

    def build_model(self) -> UrdfModel:
        """Return its Pinocchio model."""
        return build_urdf_model(self.load_robot())

    def read_shapes(self) -> tuple[list[CollisionShape], str]:
        """Return the collision geometry, and why there is none if it cannot be read."""
        try:
            return read_collision_shapes(build_urdf_model(self.load_robot(meshes=True))), ""
        except SpecError as error:
            return [], error.mistakes[0].message
