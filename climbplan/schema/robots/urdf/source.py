"""A robot section that names a URDF, read and checked together with the file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.robots.gripper import GripperSpec
from climbplan.schema.robots.urdf.checks import (
    leg_findings,
    moving_joints,
    section_findings,
    tree_findings,
)
from climbplan.schema.robots.urdf.meshes import mesh_path
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.tree import UrdfJoint, UrdfTree, read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults


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

    @property
    def needs_shapes(self) -> bool:
        """Whether collision geometry is asked for anything that the section does not say."""
        return _needs_shapes(self.spec, self.joints)

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
        """By leg, those of `joints` that follow no other."""
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

    def refused(self, findings: list[Finding]) -> SpecError:
        """Mistakes found later, at the lines of the section."""
        return SpecError(self.document.source, self.document.mistakes(self._here(findings)))

    def _here(self, findings: list[Finding]) -> list[Finding]:
        return below(self.path, findings)


def below(path: KeyPath, findings: list[Finding]) -> list[Finding]:
    """Findings of a section, at their place in the document."""
    return [Finding((*path, *f.path), f.message, f.suggestion, f.option) for f in findings]


def urdf_robot(
    spec: UrdfRobotSpec, document: Document, path: KeyPath, directory: Path
) -> tuple[UrdfRobot | None, list[Finding]]:
    """The robot of a section at `path`, or every mistake in it and its URDF.

    Paths start from `directory`.
    """
    try:
        tree = read_urdf(directory / spec.urdf)
    except (UrdfFault, UrdfFaults) as error:
        faults = error.faults if isinstance(error, UrdfFaults) else [error]
        return None, below(path, [_told(spec, fault) for fault in faults])
    return robot_of_tree(spec, document, path, directory, tree)


def robot_of_tree(
    spec: UrdfRobotSpec, document: Document, path: KeyPath, directory: Path, tree: UrdfTree
) -> tuple[UrdfRobot | None, list[Finding]]:
    """As `urdf_robot`, of a URDF that was read already."""
    found = tree_findings(tree)
    base = spec.base or (tree.roots or [""])[0]
    if not found:
        found = [*section_findings(spec, tree, base), *leg_findings(spec, tree, base)]
    meshes: dict[str, Path] = {}
    named = dict(mesh for link in tree.links.values() for mesh in link.collision_meshes)
    joints = {
        name: tuple(moving_joints(tree.way_to(leg.toe, base) or [], spec, tree))
        for name, leg in spec.legs.items()
        if not found
    }
    moved = {joint.name for own in joints.values() for joint in own}
    if not found:
        found = [
            Finding(("limb_radii", name), "no leg moves it; expected a joint of a leg")
            for name in spec.limb_radii
            if name not in moved
        ]
    if not _needs_shapes(spec, joints):
        named = {}  # no mesh is looked at
    for name, number in named.items():
        try:
            meshes[name] = mesh_path(name, tree.path, spec.packages, directory)
        except UrdfFault as fault:
            key = "packages" if fault.message.startswith("package") else "urdf"
            cure = "or `limb_radius` and `body_half_size`, with which no mesh is read"
            found.append(Finding((key,), f"{tree.at(number)}: {fault.message}, {cure}"))
    if found:
        return None, below(path, list(dict.fromkeys(found)))
    return UrdfRobot(spec, tree, base, joints, meshes, document, path, directory), []


def _needs_shapes(spec: UrdfRobotSpec, joints: dict[str, tuple[UrdfJoint, ...]]) -> bool:
    """Whether legs or body are as thick as collision geometry says, with the joints of legs."""
    moved = [joint.name for own in joints.values() for joint in own]
    stated = bool(moved) and all(name in spec.limb_radii for name in moved)
    thick = spec.limb_radius is not None or stated
    return not thick or spec.body_half_size is None


def _told(spec: UrdfRobotSpec, fault: UrdfFault) -> Finding:
    line = f"{Path(spec.urdf).name} line {fault.line}: " if fault.line else ""
    return Finding(("urdf",), f"{line}{fault.message}")
