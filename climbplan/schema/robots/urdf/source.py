"""A robot section that names a URDF, read and checked together with the file."""

from __future__ import annotations

from pathlib import Path

from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.robots.urdf.checks import (
    leg_findings,
    moving_joints,
    section_findings,
    tree_findings,
)
from climbplan.schema.robots.urdf.meshes import mesh_path
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.robot import UrdfRobot, below, needs_shapes_of
from climbplan.schema.robots.urdf.tree import UrdfTree, read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults


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
    if not needs_shapes_of(spec, joints):
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


def _told(spec: UrdfRobotSpec, fault: UrdfFault) -> Finding:
    line = f"{Path(spec.urdf).name} line {fault.line}: " if fault.line else ""
    return Finding(("urdf",), f"{line}{fault.message}")
