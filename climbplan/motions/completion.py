"""Fill in what a motion file lacks, from a URDF, a terrain mesh and a rule for contacts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from climbplan.errors import UsageError
from climbplan.motions.contact_rule import Rule, add_contacts, build_level_ground, read_foot_shapes
from climbplan.motions.link_tree import JointBounds, LinkTree, RobotFile, build_link_tree
from climbplan.motions.tracked_motion import TerrainMesh, TrackedMotion, number_names
from climbplan.schema.robots.urdf.tree import read_urdf
from climbplan.schema.robots.xml import UrdfFault, UrdfFaults


@dataclass(frozen=True)
class Completion:
    """What stands in for data that files lack."""

    robot: RobotFile | None = None
    terrain: TerrainMesh | None = None  # None: level ground, where feet are named
    ground_height: float = 0.0  # [m]
    feet: tuple[str, ...] = ()  # bodies that may touch
    foot_radius: float | None = None  # [m]
    rule: Rule = field(default_factory=Rule)


def read_robot(path: Path) -> RobotFile:
    """Read a URDF or MJCF file; raises UsageError with all that is wrong in it."""
    try:
        urdf = read_urdf(path)
    except (UrdfFault, UrdfFaults) as error:
        raise UsageError(f"--robot {path}: {error}") from error
    return RobotFile(urdf, build_link_tree(urdf))


def complete_motion(motion: TrackedMotion, stand_in: Completion) -> tuple[TrackedMotion, list[str]]:
    """Return a motion with what its file lacks, and notes of what was taken from where.

    Names, limits and contacts that the file has are kept. A terrain that is named replaces that of
    the file.

    Raises:
        UsageError: A foot is no body of the motion, or has no shape.
    """
    notes: list[str] = []
    if stand_in.robot is not None:
        motion, notes = _complete_by_robot(motion, stand_in.robot.links)
    if stand_in.terrain is not None:
        motion = replace(motion, terrain=stand_in.terrain)
    if motion.contacts is not None or not stand_in.feet:
        return motion, notes
    if motion.terrain is None:
        ground = build_level_ground(motion, stand_in.ground_height)
        motion = replace(motion, terrain=ground)
        notes.append(f"terrain: level ground at z = {stand_in.ground_height:g} m")
    urdf = None if stand_in.robot is None else stand_in.robot.urdf
    shapes = read_foot_shapes(urdf, list(stand_in.feet), stand_in.foot_radius)
    rule = stand_in.rule
    notes.append(
        f"contacts by rule: a point of a foot within {1e3 * rule.distance:g} mm of the terrain and "
        f"slower than {rule.speed:g} m/s"
    )
    return add_contacts(motion, shapes, rule), notes


def _complete_by_robot(motion: TrackedMotion, robot: LinkTree) -> tuple[TrackedMotion, list[str]]:
    """Return a motion with names and limits of a robot where the file has none."""
    note = "those of the robot, depth first; kinematics.bodies tells whether the file has them so"
    notes = []
    joints, bodies = len(motion.joint_names), len(motion.body_names)
    if motion.joint_names == number_names("joint", joints) and joints == len(robot.joint_names):
        motion = replace(motion, joint_names=robot.joint_names)
        notes.append(f"joint_names: {note}")
    if motion.body_names == number_names("body", bodies) and bodies == len(robot.link_names):
        motion = replace(motion, body_names=robot.link_names)
        notes.append(f"body_names: {note}")
    if motion.bounds is None:
        motion = replace(motion, bounds=_select_bounds(robot, motion.joint_names))
    return motion, notes


def _select_bounds(robot: LinkTree, names: Iterable[str]) -> JointBounds:
    """Return the limits of named joints; infinite where the robot has no such joint."""
    joints = [robot.joint_names.index(n) if n in robot.joint_names else -1 for n in names]
    padded = {
        name: np.append(values, -np.inf if name == "lower" else np.inf)
        for name, values in vars(robot.bounds).items()
    }
    return JointBounds(**{name: values[joints] for name, values in padded.items()})
