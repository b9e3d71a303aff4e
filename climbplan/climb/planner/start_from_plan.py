"""Climbs that start where another plan ends: `task.start: {plan: FILE}`."""

from __future__ import annotations

import json

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found
from climbplan.climb.scene.climb_scene import compute_stated_toes
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.errors import PlanFileError, SpecError, SpecMistake
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.model import Robot
from climbplan.schema.overrides import Override

_PLAN_KEY = "task.start.plan"
_ROBOT_TOLERANCE = 1e-9  # [m] and [rad] by which two copies of a robot may differ


def resolve_start_plan(loaded: LoadedClimb) -> LoadedClimb:
    """Return the climb with its start written out, if the spec names a plan to continue from.

    The text of the returned spec no longer depends on that file, as the text of a plan must not.

    Raises:
        SpecError: The file is no verified plan of the same robot.
    """
    plan_path = loaded.spec.task.start.plan
    if plan_path is None:
        return loaded
    from climbplan.climb.check.verification import verify_plan

    path = loaded.directory / plan_path
    try:
        plan = read_as_found(path)
    except PlanFileError as error:
        raise _build_spec_error(loaded, str(error)) from error
    if not plan.verified:
        raise _build_spec_error(
            loaded, f"{plan_path}: fails its verification (`climbplan verify` says where)"
        )
    verification = verify_plan(plan)  # what the file says of itself is not enough
    if not verification.passed:
        headline = verification.headline()
        raise _build_spec_error(loaded, f"{plan_path}: fails its verification: {headline}")
    difference = _describe_difference(plan.robot, build_robot(loaded.robot))
    if difference:
        raise _build_spec_error(loaded, f"{plan_path}: a plan of {plan.robot.name}, {difference}")
    return loaded.with_overrides(
        [Override("task.start", _format_last_posture(plan), f"end of {plan_path}")]
    )


def _format_last_posture(plan: ClimbPlan) -> str:
    """Return body pose and toes after the last round as YAML with all digits."""
    rounds = plan.rounds
    contact_points = compute_stated_toes(
        plan.robot, plan.terrain, rounds.toes[-1], rounds.region[-1]
    )
    toes = zip(plan.robot.limb_names, contact_points.tolist(), strict=True)
    posture = {
        "com": rounds.com[-1].tolist(),
        "rpy_deg": np.rad2deg(rounds.rpy[-1]).tolist(),
        "toes": dict(toes),
    }
    return json.dumps(posture)


def _describe_difference(plan_robot: Robot, spec_robot: Robot) -> str:
    """Describe how the plan's robot differs from the spec's; return "" if they are the same."""
    if plan_robot.limb_names != spec_robot.limb_names:
        return f"whose limbs are {', '.join(plan_robot.limb_names)}"
    if plan_robot.joint_count != spec_robot.joint_count:
        return f"whose limbs have {plan_robot.joint_count} joints"
    if not np.isclose(plan_robot.standoff, spec_robot.standoff, rtol=0, atol=_ROBOT_TOLERANCE):
        return f"with other feet than this spec's {spec_robot.name}"
    for name in ("shoulder_body", "link_lengths", "mount_yaw", "joint_lower", "joint_upper"):
        if not np.allclose(
            vars(plan_robot)[name], vars(spec_robot)[name], rtol=0, atol=_ROBOT_TOLERANCE
        ):
            return f"with another {name.replace('_', ' ')} than this spec's {spec_robot.name}"
    angles = (spec_robot.joint_lower + spec_robot.joint_upper) / 2
    plan_points, spec_points = (
        joint_points_body(robot, angles) for robot in (plan_robot, spec_robot)
    )
    if not np.allclose(plan_points, spec_points, rtol=0, atol=_ROBOT_TOLERANCE):
        return f"with other joints than this spec's {spec_robot.name}"
    return ""


def _build_spec_error(loaded: LoadedClimb, message: str) -> SpecError:
    return loaded.locate(SpecError(loaded.source, [SpecMistake(_PLAN_KEY, message)]))
