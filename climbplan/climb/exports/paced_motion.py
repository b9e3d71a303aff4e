"""The motion of a climb or transition at another pace, with its contact forces solved again.

Plans are quasi-static. Played faster, their links' inertia counts: forces and torques are those of
`climbplan.motions.pace`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from climbplan.climb.exports.motion import read_plan_urdf
from climbplan.climb.exports.tracked_motion import build_tracked_motion
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.errors import UsageError
from climbplan.motions.link_tree import RobotFile, build_link_tree
from climbplan.motions.pace import (
    build_force_problem,
    find_fastest_pace,
    find_pace_obstacle,
    retime_motion,
)
from climbplan.motions.tracked_motion import DEFAULT_RATE, TrackedMotion

_RESERVE = 0.95  # of the fastest pace, at which no torque and no friction is left


def read_paced_motion(path: Path, rate: float | None, pace: float | None) -> TrackedMotion:
    """Read a climb or transition plan as a motion at a pace.

    Args:
        path: The plan file.
        rate: Sample rate [Hz]; None takes 50 Hz.
        pace: Factor on the planned speed; None takes 0.95 of the fastest by inverse dynamics, and
            at least the planned one.

    Raises:
        PlanFileError: It is no climb or damaged.
        UsageError: The robot is none of a URDF, or has no forces for the pace.
    """
    plan = read_climb(path)
    robot = read_plan_robot(plan)
    if robot is None:
        raise UsageError(f"{path}: no pace: expected a robot from a URDF, whose links have masses")
    factor = find_plan_pace(plan, robot) if pace is None else pace
    motion = build_paced_motion(plan, robot, DEFAULT_RATE if rate is None else rate, factor)
    if motion is None:
        raise UsageError(
            f"--pace {factor:g}: joints, or contact forces within friction and torque limits, do "
            "not move the links so fast; expected less, or fastest"
        )
    return motion


def read_plan_robot(plan: ClimbPlan) -> RobotFile | None:
    """Return the URDF that a plan carries; None if it carries none."""
    robot = read_plan_urdf(plan)
    return None if robot is None else RobotFile(robot.tree, build_link_tree(robot.tree))


def find_plan_pace(plan: ClimbPlan, robot: RobotFile) -> float:
    """Return 0.95 of the fastest pace of a plan by inverse dynamics, or 1 if that is less.

    Raises:
        UsageError: No forces can be solved for the motion.
    """
    motion = build_tracked_motion(plan, DEFAULT_RATE)
    return max(1.0, _RESERVE * find_fastest_pace(build_force_problem(motion, robot)))


def has_pace(plan: ClimbPlan, robot: RobotFile) -> bool:
    """Return whether forces can be solved for the motion of a plan."""
    return not find_pace_obstacle(build_tracked_motion(plan, DEFAULT_RATE), robot)


def build_paced_motion(
    plan: ClimbPlan, robot: RobotFile, rate: float, pace: float
) -> TrackedMotion | None:
    """Return the motion of a plan at a pace; None if a sample has no contact forces.

    Args:
        plan: The plan.
        robot: Its robot.
        rate: Sample rate of the motion [Hz].
        pace: Factor on the planned speed.

    Raises:
        UsageError: No forces can be solved for the motion.
    """
    slow_motion = build_tracked_motion(plan, rate / pace)
    motion = retime_motion(slow_motion, build_force_problem(slow_motion, robot), pace)
    if motion is None:
        return None
    return replace(motion, fps=rate, facts={**motion.facts, "pace": pace})
