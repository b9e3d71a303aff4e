"""A robot from whatever a spec says of it."""

from __future__ import annotations

from climbplan.robots.model import Robot
from climbplan.schema.document import Finding
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.urdf.robot import UrdfRobot


def build_robot(spec: AnyRobot) -> Robot:
    """The arrays of a robot of any kind.

    Raises MissingSolver and SpecError for robots from URDFs, as `robot_of_urdf`.
    """
    if isinstance(spec, UrdfRobot):
        from climbplan.robots.urdf.robot_builder import build_robot_from_urdf

        return build_robot_from_urdf(spec)
    return Robot.from_spec(spec)


def without_flat_feet(spec: AnyRobot, what: str) -> AnyRobot:
    """The same robot; raises SpecError, at the key of its feet, where these are flat."""
    if isinstance(spec, UrdfRobot) and spec.spec.flat_feet:
        message = (
            f"flat feet are for `plan-climb`; {what} would take them for points: expected "
            "`radius`, or no `foot`"
        )
        raise spec.refused([Finding(("foot",), message)])
    return spec


def assumptions(spec: AnyRobot, robot: Robot) -> tuple[str, ...]:
    """What a plan rests on that neither the spec nor the URDF says."""
    if not isinstance(spec, UrdfRobot):
        return ()
    from climbplan.robots.urdf.capsule_fit import LIMB_RADIUS

    given, out = spec.spec, []
    if "joint_stiffness" not in given.model_fields_set:
        out.append(f"joint_stiffness {given.joint_stiffness:g} N m/rad: no URDF says it")
    if "slide_stiffness" not in given.model_fields_set and robot.slides.any():
        out.append(f"slide_stiffness {given.slide_stiffness:g} N/m")
    if "structural_compliance_share" not in given.model_fields_set:
        out.append("structural_compliance_share 0: links as rigid bodies")
    if given.limb_radius is None and robot.capsules is None:
        out.append(f"limb_radius {LIMB_RADIUS:g} m")
    if robot.capsules is not None and len(robot.touching):
        out.append(f"not looked at, as they always touch: {_pairs(robot)}")
    if given.workspace.stance_radius is None:
        out.append(f"workspace.stance_radius {robot.stance_radius:g} m, sampled")
    held = sorted(
        joint.name
        for joint in spec.tree.joints.values()
        if joint.kind != "fixed"
        and joint.name not in given.locked
        and not any(joint in own for own in spec.joints.values())
    )
    if held:
        out.append(f"held at zero, as no leg has them: {', '.join(held)}")
    return (f"assumed of {spec.name}: {'; '.join(out)}",) if out else ()


def _pairs(robot: Robot) -> str:
    """Parts that touch however it stands: "LF's LF_HFE and the body"."""
    assert robot.capsules is not None
    told: list[str] = []
    for limb, own, other, behind in robot.touching.tolist():
        one = (
            f"{robot.limb_names[limb]}'s {robot.joint_name(limb, robot.capsules.joint[limb, own])}"
        )
        beside = "the body"
        if other >= 0:
            link = robot.joint_name(other, robot.capsules.joint[other, behind])
            beside = f"{robot.limb_names[other]}'s {link}"
        told.append(f"part of {one} and {beside}")
    return ", ".join(dict.fromkeys(told))
