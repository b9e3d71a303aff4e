"""Build a robot from any kind of robot spec."""

from __future__ import annotations

from dataclasses import replace

from climbplan.robots.model import Robot
from climbplan.schema.document import Finding
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.urdf.robot import UrdfRobot


def build_robot(spec: AnyRobot) -> Robot:
    """Build the arrays of a robot of any kind.

    The last robot from a URDF is kept: planner, scene and checks build the same one again.

    Raises:
        MissingSolver: The robot is from a URDF and Pinocchio is not installed.
        SpecError: The URDF is wrong.
    """
    if isinstance(spec, UrdfRobot):
        from climbplan.robots.urdf.robot_builder import build_robot_from_urdf

        global _last
        stamps, last = _stamp_meshes(spec), _last  # read once: another thread may replace it
        if last is None or last[0] != spec or last[1] != stamps:
            last = _last = (spec, stamps, build_robot_from_urdf(spec))
        return replace(last[2], **spec.mesh_fields)
    return Robot.from_spec(spec)


_last: tuple[UrdfRobot, list[tuple[int, int]], Robot] | None = None


def _stamp_meshes(robot: UrdfRobot) -> list[tuple[int, int]]:
    """Return time of change and size of the robot's meshes; zeros for those that are missing."""
    stamps = []
    for path in robot.meshes.values():
        try:
            status = path.stat()
            stamps.append((status.st_mtime_ns, status.st_size))
        except OSError:
            stamps.append((0, 0))
    return stamps


def require_no_flat_feet(spec: AnyRobot, what: str) -> AnyRobot:
    """Return the same robot if its feet are not flat.

    Args:
        spec: The robot.
        what: The command or feature that does not support flat feet, for the message.

    Raises:
        SpecError: Its feet are flat; at their key.
    """
    if isinstance(spec, UrdfRobot) and spec.spec.flat_feet:
        message = (
            f"flat feet are for `plan-climb`; {what} would take them for points: expected "
            "`radius`, or no `foot`"
        )
        raise spec.build_error([Finding(("foot",), message)])
    return spec


def list_assumptions(spec: AnyRobot, robot: Robot) -> tuple[str, ...]:
    """Return what a plan assumes that neither the spec nor the URDF says."""
    if not isinstance(spec, UrdfRobot):
        return ()
    from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS

    section, notes = spec.spec, []
    if "joint_stiffness" not in section.model_fields_set:
        notes.append(f"joint_stiffness {section.joint_stiffness:g} N m/rad: no URDF says it")
    if "slide_stiffness" not in section.model_fields_set and robot.slides.any():
        notes.append(f"slide_stiffness {section.slide_stiffness:g} N/m")
    if "structural_compliance_share" not in section.model_fields_set:
        notes.append("structural_compliance_share 0: links as rigid bodies")
    if section.limb_radius is None and robot.capsules is None:
        notes.append(f"limb_radius {LIMB_RADIUS:g} m")
    if robot.capsules is not None and len(robot.touching):
        notes.append(f"not looked at, as they always touch: {_describe_touching_pairs(robot)}")
    if section.workspace.stance_radius is None:
        notes.append(f"workspace.stance_radius {robot.stance_radius:g} m, sampled")
    locked = sorted(
        joint.name
        for joint in spec.tree.joints.values()
        if joint.kind != "fixed"
        and joint.name not in section.locked
        and not any(joint in leg_joints for leg_joints in spec.joints.values())
    )
    if locked:
        notes.append(f"held at zero, as no leg has them: {', '.join(locked)}")
    return (f"assumed of {spec.name}: {'; '.join(notes)}",) if notes else ()


def _describe_touching_pairs(robot: Robot) -> str:
    """Return pairs of parts that always touch: "LF's LF_HFE and the body"."""
    assert robot.capsules is not None
    pairs: list[str] = []
    for limb, capsule, other_limb, other_capsule in robot.touching.tolist():
        link = robot.joint_name(limb, robot.capsules.joint[limb, capsule])
        first = f"{robot.limb_names[limb]}'s {link}"
        second = "the body"
        if other_limb >= 0:
            link = robot.joint_name(other_limb, robot.capsules.joint[other_limb, other_capsule])
            second = f"{robot.limb_names[other_limb]}'s {link}"
        pairs.append(f"part of {first} and {second}")
    return ", ".join(dict.fromkeys(pairs))
