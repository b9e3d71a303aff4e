"""Read a robot section that names a URDF and check it together with that file."""

from __future__ import annotations

from pathlib import Path

from climbplan.schema.document import Document, Finding, KeyPath
from climbplan.schema.robots.urdf.checks import (
    check_legs,
    check_section,
    check_tree,
    select_moving_joints,
)
from climbplan.schema.robots.urdf.meshes import find_mesh
from climbplan.schema.robots.urdf.model import UrdfRobotSpec
from climbplan.schema.robots.urdf.robot import UrdfRobot, prefix_findings, requires_shapes
from climbplan.schema.robots.urdf.tree import UrdfTree, read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults


def build_urdf_robot(
    spec: UrdfRobotSpec, document: Document, path: KeyPath, directory: Path
) -> tuple[UrdfRobot | None, list[Finding]]:
    """Return the robot of a section at `path`, or every mistake in it and its URDF.

    Paths start from `directory`.
    """
    try:
        tree = read_urdf(directory / spec.urdf)
    except (UrdfFault, UrdfFaults) as error:
        faults = error.faults if isinstance(error, UrdfFaults) else [error]
        return None, prefix_findings(path, [_report_fault(spec, fault) for fault in faults])
    return build_robot_from_tree(spec, document, path, directory, tree)


def build_robot_from_tree(
    spec: UrdfRobotSpec, document: Document, path: KeyPath, directory: Path, tree: UrdfTree
) -> tuple[UrdfRobot | None, list[Finding]]:
    """Return the robot of a section whose URDF was read already, or every mistake in both."""
    findings = check_tree(tree)
    base = spec.base or (tree.roots or [""])[0]
    if not findings:
        findings = [*check_section(spec, tree, base), *check_legs(spec, tree, base)]
    meshes: dict[str, Path] = {}
    mesh_lines = dict(mesh for link in tree.links.values() for mesh in link.collision_meshes)
    joints = {
        name: tuple(select_moving_joints(tree.way_to(leg.toe, base) or [], spec, tree))
        for name, leg in spec.legs.items()
        if not findings
    }
    moved_joints = {joint.name for leg_joints in joints.values() for joint in leg_joints}
    if not findings:
        findings = [
            Finding(("limb_radii", name), "no leg moves it; expected a joint of a leg")
            for name in spec.limb_radii
            if name not in moved_joints
        ]
    if not requires_shapes(spec, joints):
        mesh_lines = {}  # no mesh is looked at
    for name, number in mesh_lines.items():
        try:
            meshes[name] = find_mesh(name, tree.path, spec.packages, directory)
        except UrdfFault as fault:
            if spec.missing_meshes == "ignore":
                continue
            key = "packages" if fault.message.startswith("package") else "urdf"
            cure = (
                "or `missing_meshes: ignore`, or `limb_radius` and `body_half_size`, with which no "
                "mesh is read"
            )
            findings.append(
                Finding((key,), f"{tree.format_location(number)}: {fault.message}, {cure}")
            )
    if findings:
        return None, prefix_findings(path, list(dict.fromkeys(findings)))
    return UrdfRobot(spec, tree, base, joints, meshes, document, path, directory), []


def _report_fault(spec: UrdfRobotSpec, fault: UrdfFault) -> Finding:
    line = f"{Path(spec.urdf).name} line {fault.line}: " if fault.line else ""
    return Finding(("urdf",), f"{line}{fault.message}")
