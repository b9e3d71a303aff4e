"""Compare robot, terrain and spine model in the file with those that the spec determines.

A plan carries the robot files that its spec names. Where an older plan does not, the check says so
and uses the robot in the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.grips import GripPlan, SpineModel
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import ClimbplanError, MissingSolver, SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.model import Robot
from climbplan.robots.task_robot import heading_as, standing_as, with_grip_limit, with_stance
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.robots.stored import NotKept, StoredRobot, build_stored_robot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.terrain.model import build_terrain
from climbplan.verification.check import Check, LeftOut, judge, mark_not_compared
from climbplan.verification.differences import Difference, compare_recursively, select_largest

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionSpec


def compare_with_spec(
    plan: ClimbPlan, spec: ClimbSpec | TransitionSpec, given_robot: AnyRobot | None = None
) -> Iterator[Check]:
    """Yield checks of what the spec determines, built by the loaders that planning uses.

    Args:
        plan: The plan.
        spec: Its spec.
        given_robot: The spec's robot, where its files are at hand; None for that in the plan.
    """
    robot, spec_robot = plan.robot, None
    try:
        if given_robot is None:
            stored = build_stored_robot(parse_yaml(plan.spec_text, "spec"), plan.robot_texts)
        else:
            stored = StoredRobot(given_robot)
        spec_robot = stored.robot
        robot = _build_task_robot(plan, spec, spec_robot)
        yield _check_robot(plan, robot, stored)
    except (NotKept, MissingSolver) as reason:
        note = f"{reason}: the robot is taken from the plan file"
        yield mark_not_compared(judge("robot.spec", 0.0), note, "robot as stored", note)
    except SpecError as error:
        yield judge("robot.spec", float("inf"), str(error).splitlines()[0])
        return
    yield _check_terrain(plan, spec, robot)
    if plan.grips is not None and isinstance(spec, ClimbSpec):
        yield _check_spine_model(plan, plan.grips, spec, spec_robot)


def _build_task_robot(
    plan: ClimbPlan, spec: ClimbSpec | TransitionSpec, spec_robot: AnyRobot
) -> Robot:
    """Return the robot as the task uses it."""
    robot = build_robot(spec_robot)
    if robot.limb_names != plan.robot.limb_names:
        return robot
    robot = with_stance(robot, spec.task.stance)
    robot = heading_as(robot, plan.rounds.rpy[0])
    if not isinstance(spec, ClimbSpec):
        return robot
    robot = with_grip_limit(robot, spec.gripper.max_force)
    rounds = plan.rounds
    return standing_as(robot, rounds.com[0], rounds.rpy[0], rounds.toes[0], spec.task.stance)


def _check_robot(plan: ClimbPlan, robot: Robot, stored: StoredRobot) -> Check:
    """Compare the robot in the file with that of the spec."""
    unknown, models, missing_parts = list(stored.unknown), [], []
    if plan.robot.links is None and robot.links is not None:  # plans of before
        unknown.append("links")
        models.append("links without mass")
        percentage = 100 * robot.links.mass_fraction
        missing_parts.append(
            f"the weight of links, {percentage:.0f} % of all, which it counts to the body"
        )
    if plan.robot.dynamics is None:  # plan files without rotors: they do not enter planning
        unknown.append("dynamics")
    worst = select_largest(compare_recursively("robot", plan.robot, robot, unknown))
    check = judge("robot.spec", worst.size, _describe_difference(worst, plan.robot))
    if stored.unknown:
        names = " and ".join(stored.unknown)
        margin = f"{names} not compared: from meshes, which the plan does not carry"
        check = replace(check, margin=margin)
        models.append("meshes as stored")
        missing_parts.append(
            f"{names} from meshes, which the plan does not carry: taken from the plan file"
        )
    if not models:
        return check
    return replace(check, left_out=LeftOut(", ".join(models), "; ".join(missing_parts)))


def _check_terrain(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec, robot: Robot) -> Check:
    """Compare the terrain in the file with that of the spec."""
    try:
        terrain = build_terrain(spec.terrain, robot)
    except ClimbplanError as error:
        return judge("terrain.spec", float("inf"), str(error).splitlines()[0])
    # The raw surface of a scan is in no spec: the checks scan.* hold the plan against it
    worst = select_largest(
        compare_recursively("terrain", replace(plan.terrain, scan=None), terrain)
    )
    return judge("terrain.spec", worst.size, _describe_difference(worst, plan.robot))


def _check_spine_model(
    plan: ClimbPlan, grips: GripPlan, spec: ClimbSpec, spec_robot: AnyRobot | None
) -> Check:
    """Compare the spine model in the file with the one that spec or robot name."""
    # Its file, and nothing else of what planning uses: only plans that grip need it.
    from climbplan.mechanics.gripper_model import load_model

    model_name = spec.gripper.model
    if model_name is None and spec_robot is not None and spec_robot.gripper is not None:
        model_name = spec_robot.gripper.model
    if model_name is None or model_name.endswith(".json"):
        cause = f"the plan does not carry {model_name}" if model_name else "the robot says which"
        note = f"{cause}: the model of spines is taken from the plan file"
        return mark_not_compared(judge("grip.model", 0.0), note, "spines as stored", note)
    try:
        model = SpineModel(**vars(load_model(model_name)))
    except ClimbplanError as error:
        return judge("grip.model", float("inf"), str(error))
    worst = select_largest(compare_recursively("grips.model", grips.model, model))
    return judge("grip.model", worst.size, _describe_difference(worst, plan.robot))


def _describe_difference(worst: Difference, robot: Robot) -> str:
    """Describe a difference in the robot's terms: "robot.joint_upper, RF femur: 9 in the file,
    ...".
    """
    if worst.size == 0:
        return ""
    place = ""
    name = worst.key.removeprefix("robot.")
    if worst.index and (worst.key == "terrain.allowed" or name in vars(robot)):
        limb = worst.index[0]
        place = f", {robot.limb_names[limb]}" if name != "body_hull" else ""
        if len(worst.index) == 2 and vars(robot).get(name, robot.mount_yaw).shape == (
            robot.limb_count,
            robot.joint_count,
        ):
            place += f" {robot.joint_name(*worst.index)}"
    return f"{worst.key}{place}: {worst.values}"
