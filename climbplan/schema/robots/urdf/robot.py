"""A robot from a URDF, as sections of specs state it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.robots.gripper import GripperSpec
from climbplan.schema.robots.urdf.model import UrdfRobotSpec

if TYPE_CHECKING:
    from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree


@dataclass(frozen=True)
class UrdfRobot:
    """A robot from a URDF whose text holds together; what it weighs and reaches is still open."""

    spec: UrdfRobotSpec
    tree: UrdfTree
    base: str  # link that is the body
    joints: dict[str, tuple[UrdfJoint, ...]]  # those that move, by leg, from base to toe
    meshes: dict[str, Path]  # collision meshes, by the name that the URDF gives them
    document: Document = field(repr=False, compare=False)
    path: KeyPath  # of the section in the document
    directory: Path = field(default=Path(), repr=False, compare=False)  # that paths start from
    is_stored: bool = False  # whether it is from a plan file, whose robot is what it was
    # Fields of the built robot that only meshes tell, where these are not at hand, by name
    mesh_fields: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def needs_shapes(self) -> bool:
        """Return whether collision geometry is asked for anything that the section does not say."""
        return requires_shapes(self.spec, self.joints)

    @property
    def name(self) -> str:
        """Name for reports."""
        return self.spec.name or self.tree.name

    @property
    def limb_names(self) -> tuple[str, ...]:
        """Legs, in their order."""
        return tuple(self.spec.legs)

    @property
    def own_joints(self) -> dict[str, tuple[UrdfJoint, ...]]:
        """The joints of each leg that follow no other joint."""
        return {
            name: tuple(joint for joint in joints if joint.mimic is None)
            for name, joints in self.joints.items()
        }

    @property
    def gripper(self) -> GripperSpec | None:
        """Grippers at its toes, if it has some."""
        return self.spec.gripper

    @property
    def kind(self) -> str:
        """`robot`, as of every robot."""
        return self.spec.kind

    def build_error(self, findings: list[Finding]) -> SpecError:
        """Return mistakes found later, at the lines of the section."""
        return SpecError(self.document.source, self.document.mistakes(self._prefix(findings)))

    def _prefix(self, findings: list[Finding]) -> list[Finding]:
        return prefix_findings(self.path, findings)


def prefix_findings(path: KeyPath, findings: list[Finding]) -> list[Finding]:
    """Return findings of a section, at their place in the document."""
    return [Finding((*path, *f.path), f.message, f.suggestion, f.option) for f in findings]


def requires_shapes(spec: UrdfRobotSpec, joints: dict[str, tuple[UrdfJoint, ...]]) -> bool:
    """Return whether the thickness of legs or body comes from collision geometry."""
    moved_joints = [joint.name for leg_joints in joints.values() for joint in leg_joints]
    stated = bool(moved_joints) and all(name in spec.limb_radii for name in moved_joints)
    thick = spec.limb_radius is not None or stated
    return not thick or spec.body_half_size is None
