"""Climbs that go on where another plan ends: `task.start: {plan: FILE}`."""

from __future__ import annotations

import json

import numpy as np

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found
from climbplan.climb.scene.climb_scene import toes_as_stated
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.errors import PlanFileError, SpecError, SpecMistake
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.model import Robot
from climbplan.schema.overrides import Override

_KEY = "task.start.plan"
_SAME = 1e-9  # [m] and [rad] by which two copies of a robot may differ


def started(loaded: LoadedClimb) -> LoadedClimb:
    """The climb with its start written out, if the spec names a plan that it goes on from.

    The spec's text then says the same without that file, as a plan must. Raises SpecError for a
    file that is no verified plan of the same robot.
    """
    given = loaded.spec.task.start.plan
    if given is None:
        return loaded
    from climbplan.climb.check.verification import verification_of

    path = loaded.directory / given
    try:
        plan = read_as_found(path)
    except PlanFileError as error:
        raise _refused(loaded, str(error)) from error
    if not plan.verified:
        raise _refused(loaded, f"{given}: fails its verification (`climbplan verify` says where)")
    verification = verification_of(plan)  # what the file says of itself is not enough
    if not verification.passed:
        headline = verification.headline()
        raise _refused(loaded, f"{given}: fails its verification: {headline}")
    other = _difference(plan.robot, build_robot(loaded.robot))
    if other:
        raise _refused(loaded, f"{given}: a plan of {plan.robot.name}, {other}")
    return loaded.with_overrides([Override("task.start", _last_posture(plan), f"end of {given}")])


def _last_posture(plan: ClimbPlan) -> str:
    """Body and toes after the last round, as YAML with all digits."""
    rounds = plan.rounds
    touching = toes_as_stated(plan.robot, plan.terrain, rounds.toes[-1], rounds.region[-1])
    toes = zip(plan.robot.limb_names, touching.tolist(), strict=True)
    posture = {
        "com": rounds.com[-1].tolist(),
        "rpy_deg": np.rad2deg(rounds.rpy[-1]).tolist(),
        "toes": dict(toes),
    }
    return json.dumps(posture)


def _difference(planned: Robot, own: Robot) -> str:
    """What a plan's robot has that the spec's has not; empty if they are the same."""
    if planned.limb_names != own.limb_names:
        return f"whose limbs are {', '.join(planned.limb_names)}"
    if planned.joint_count != own.joint_count:
        return f"whose limbs have {planned.joint_count} joints"
    if not np.isclose(planned.standoff, own.standoff, rtol=0, atol=_SAME):
        return f"with other feet than this spec's {own.name}"
    for name in ("shoulder_body", "link_lengths", "mount_yaw", "joint_lower", "joint_upper"):
        if not np.allclose(vars(planned)[name], vars(own)[name], rtol=0, atol=_SAME):
            return f"with another {name.replace('_', ' ')} than this spec's {own.name}"
    angles = (own.joint_lower + own.joint_upper) / 2
    there, here = (joint_points_body(robot, angles) for robot in (planned, own))
    if not np.allclose(there, here, rtol=0, atol=_SAME):
        return f"with other joints than this spec's {own.name}"
    return ""


def _refused(loaded: LoadedClimb, message: str) -> SpecError:
    return loaded.placed(SpecError(loaded.source, [SpecMistake(_KEY, message)]))
