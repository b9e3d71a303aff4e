"""Walks of a generated robot configuration: its walking spec, planned before it is written."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from climbplan.errors import NoPlanFound, SpecError
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.urdf.proposal.robot_document import format_robot_document
from climbplan.robots.urdf.proposal.walk_document import STANCE_INTERVALS, format_walk_document
from climbplan.robots.urdf.proposal.walking_stance import propose_walking_stances
from climbplan.robots.urdf.walking_body import build_walking_body
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.planner.swing_effort import compute_swing_effort, compute_swing_speed
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.task.task import ANGLES, VELOCITY

_TIME_LIMIT = "solver.time_limit=3600"  # a cap: the budget of QPs ends the search
# Factors of haste and of interval length, tried in order while the walk lags behind. A turn has no
# required duration, so that slow legs may swing for longer
_FORWARD_TRIALS = ((1.0, 1.0), (10.0, 1.0))
_TURNING_TRIALS = (*_FORWARD_TRIALS, (1.0, 2.0), (10.0, 2.0))
_MIN_ACHIEVEMENT = 0.9  # of the reference speed or yaw
_SPEED_WINDOW = 4  # the speed of a walk is that of its last quarter
_MAX_POSTURES = 1  # that is tried if a plan in the one in which it stands is refused


@dataclass(frozen=True)
class ProposedWalk:
    """The walking spec of a robot, or the reason for none, and the outcome of planning it."""

    what: str
    proposal: RobotProposal  # in the posture of the walk
    text: str  # empty where the robot cannot walk by `plan-mpc`
    plan: WalkPlan | None  # verified, and as fast as its reference; else None
    message: str  # "verified" with the speed or yaw that it reaches; else the reason
    lags: bool = False  # whether there is a plan, which is slower than its reference

    def __str__(self) -> str:
        return f"{self.what}: {self.message}"


def plan_proposed_walk(
    proposal: RobotProposal, robot_file: str, other_file: str, turns: bool = False
) -> ProposedWalk:
    """Plan a walk of the robot as it stands, or else in other postures.

    Args:
        proposal: The robot configuration.
        robot_file: Name of the robot file in the spec.
        other_file: Name of the robot file in the spec, for another posture.
        turns: Turn on the spot instead of walking forward.

    Returns:
        The first walk that is verified; else the first one, with messages of all. Other postures
        lag as well where the first one does.
    """
    first = plan_walk_as_proposed(proposal, robot_file, turns)
    if first.plan is not None or first.lags:
        return first
    alternatives, lack = propose_walking_stances(proposal, _MAX_POSTURES)
    messages = [first.message]
    for alternative in alternatives:
        walk = plan_walk_as_proposed(alternative, other_file, turns)
        if walk.plan is not None:
            return walk
        messages.append(f"in another posture {walk.message}")
    if lack:
        messages.append(lack)
    return replace(first, message="; ".join(dict.fromkeys(messages)))


def plan_walk_as_proposed(
    proposal: RobotProposal, robot_file: str, turns: bool = False
) -> ProposedWalk:
    """Plan a walk of the robot in one posture.

    A walk that lags behind its reference is planned again, with more haste. A turn is planned again
    with longer intervals, too.

    Args:
        proposal: The robot configuration.
        robot_file: Name of the robot file in the spec.
        turns: Turn on the spot instead of walking forward.
    """
    what = "turns on the spot" if turns else "walks at speed"
    try:
        robot = proposal.draft.load_robot(meshes=False)
        body = build_walking_body(robot)
    except SpecError as error:
        return ProposedWalk(what, proposal, "", None, f"no spec: {error.mistakes[0].message}")
    model = build_urdf_model(robot)

    def effort(speed: float, step: float, lift: float) -> float:
        return compute_swing_effort(model, body.legs, speed, step, lift, STANCE_INTERVALS)

    def joint_speed(speed: float, step: float, lift: float) -> float:
        return compute_swing_speed(body.legs, speed, step, lift, STANCE_INTERVALS)

    first: ProposedWalk | None = None
    for haste, slower in _TURNING_TRIALS if turns else _FORWARD_TRIALS:
        text = format_walk_document(
            body, robot_file, effort, turns, haste, slower, joint_speed=joint_speed
        )
        plan, message, lags = _plan_spec(proposal, robot_file, text, turns)
        walk = ProposedWalk(what, proposal, text, None if lags else plan, message, lags)
        if walk.plan is not None:
            return walk
        first = first or walk
        if not lags:
            break
    assert first is not None
    return first


def _plan_spec(
    proposal: RobotProposal, robot_file: str, text: str, turns: bool
) -> tuple[WalkPlan | None, str, bool]:
    """Plan a walking spec.

    Returns:
        The verified plan or None, a message, and whether the walk lags behind its reference.
    """
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder)
        absolute = format_robot_document(proposal, str(proposal.draft.urdf), "")
        (directory / robot_file).write_text(absolute, encoding="utf-8")
        (directory / "walk.yaml").write_text(text, encoding="utf-8")
        try:
            plan = plan_walk(load_mpc(directory / "walk.yaml", [_TIME_LIMIT]))
        except (NoPlanFound, SpecError) as error:
            return None, str(error).partition("\n")[0], False
    reached, target, unit = _measure_turn(plan) if turns else _measure_speed(plan)
    achievement, lags = f"{reached:.2f} of {target:.2f} {unit}", reached < _MIN_ACHIEVEMENT * target
    if broken := format_failures(check_trajectory(plan.task, plan.trajectory)):
        return None, f"the plan of {achievement} breaks {broken}", lags
    return (
        plan,
        f"the plan reaches {achievement} alone" if lags else f"verified, {achievement}",
        lags,
    )


def _measure_speed(plan: WalkPlan) -> tuple[float, float, str]:
    """Return the mean forward speed of the last quarter, its reference, and the unit."""
    speed = plan.trajectory.state[:, VELOCITY][:, 0]
    last = max(len(speed) // _SPEED_WINDOW, 1)
    return float(speed[-last:].mean()), float(plan.task.reference.velocity[-1, 0]), "m/s"


def _measure_turn(plan: WalkPlan) -> tuple[float, float, str]:
    """Return the yaw at the end, its reference, and the unit."""
    yaw = plan.trajectory.state[-1, ANGLES][2]
    target = plan.task.reference.euler[-1, 2]
    return float(np.rad2deg(yaw)), float(np.rad2deg(target)), "deg"
