"""Checks that the plan answers its spec: bounds, loads, robot, terrain and objective.

The terrain is compared twice: corner by corner, and as planning builds it.

Chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.gait import ClimbGait, reconstruct_gait
from climbplan.climb.check.anew.kinematics import compute_body_axes
from climbplan.climb.check.anew.spec import compare_with_spec
from climbplan.climb.check.normals import compute_normals
from climbplan.climb.check.subject import Subject
from climbplan.climb.check.terrain import compare_terrain
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.schema.model import MIN_PACED_RATE, ClimbSpec, GoalSpec
from climbplan.errors import SpecError
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.verification.check import Check, judge, judge_worst, mark_unjudged
from climbplan.verification.differences import Difference, check_equality, measure_difference

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionSpec


def check_penetration(subject: Subject, required: float | None) -> Check:
    """Check the penetration of commands, n . J (angles - commands) >= required [m].

    A joint that is a spring is commanded beyond its angle by its deflection under the contact
    force. Shear deflects limbs as well. Where it does so away from the surface by more than
    pressure does towards it, the commanded toe is off the surface. Friction alone then holds it
    there. A toe that touches down late, or slides once, never finds the surface.

    The check is to first order, as plans state it. The message also gives the exact penetration of
    the commanded toes, which is the one in reports. Commands outside are reported but not judged
    where the spec requires no penetration.
    """
    instants, forces = subject.plan.instants, subject.plan.forces
    joint_deflection = instants.joint_angles - forces.joint_command
    toe_motion = np.einsum("knij,knj->kni", subject.limbs.jacobian(), joint_deflection)
    penetration = np.einsum("kni,kni->kn", toe_motion, instants.normal)
    standing = np.where(instants.contact, penetration, np.inf)
    num_outside = int((standing < 0).sum())
    commanded_depth = np.einsum("kni,kni->kn", instants.toes - forces.toe_command, instants.normal)
    standing_command = np.where(instants.contact, commanded_depth, np.inf)
    linear, commanded = _format_min_depth(standing), _format_min_depth(standing_command)
    margin = f"{linear} inside at least to first order, {commanded} as commanded"
    if num_outside:
        margin += f", {num_outside} of {int(instants.contact.sum())} commands outside"
    residual = np.where(instants.contact, (required or 0.0) - penetration, -np.inf)
    check = judge_worst("force.penetration", residual, subject.describe_instant, margin=margin)
    if required is not None or check.passed:
        return check
    # Nothing is left out of the plan: what friction has to hold is judged by the static checks.
    return mark_unjudged(check, "force.min_penetration is not asked")


def _format_min_depth(depth: np.ndarray) -> str:
    """Format the smallest of depths [m] in millimetres, without "-0.0"."""
    return f"{round(1e3 * float(depth.min(initial=np.inf)), 1) + 0.0:.1f} mm"


def check_spec(subject: Subject, robot: AnyRobot | None = None) -> Iterator[Check]:
    """Yield checks of the plan's spec against its numbers.

    robot: Replaces the robot that the plan carries; None keeps it.
    """
    plan = subject.plan
    spec = _read_spec(plan)
    if isinstance(spec, str):
        yield judge("file.spec_values", math.inf, spec)
        return
    differences = [
        *_compare_task(plan, spec),
        *_compare_limits(plan, spec),
        *compare_terrain(plan, spec),
    ]
    worst = max(differences, key=lambda d: math.inf if math.isnan(d.size) else d.size)
    yield judge("file.spec_values", worst.size, worst.key if worst.size > 0 else "")
    yield from compare_with_spec(plan, spec, robot)
    yield _check_objective(plan, spec)
    if plan.robot.gripper is None:
        yield check_penetration(subject, spec.force.min_penetration)


def bind_to_spec(plan: ClimbPlan, other_spec: HeldSpec) -> ClimbPlan:
    """Return the plan as an answer to another spec, with the bounds of that spec."""
    rebound = replace(plan, spec_text=other_spec.text)
    spec = _read_spec(rebound)
    if isinstance(spec, str):
        return rebound  # `check_spec` says what is wrong with it
    return replace(rebound, limits=replace(plan.limits, **_collect_bounds(spec)))


def read_margins(plan: ClimbPlan) -> MarginsSpec | None:
    """Return the margins of the plan's spec; None for none, or if it is no valid spec."""
    spec = _read_spec(plan)
    if isinstance(spec, str):
        return None
    gripping = plan.robot.gripper is not None
    has_margins = spec.margins.asked_of_grips if gripping else spec.margins.asked
    return spec.margins if has_margins else None


def read_payload(plan: ClimbPlan) -> tuple[float, Array]:
    """Return the mass that the spec puts on the body [kg], and where (3,), body frame [m]."""
    spec = _read_spec(plan)
    if isinstance(spec, str):
        return 0.0, np.zeros(3)
    return spec.task.payload.mass, np.array(spec.task.payload.offset, float)


def states_pace(plan: ClimbPlan) -> bool:
    """Return whether the spec states a pace, so that the dynamics of the links time the motion."""
    spec = _read_spec(plan)
    return not isinstance(spec, str) and spec.trajectory.pace is not None


def read_risk_limit(plan: ClimbPlan) -> float | None:
    """Return the largest probability of a fall that the spec allows; None without a limit."""
    spec = _read_spec(plan)
    return None if isinstance(spec, str) else spec.risk


def counts_in_closed_loop(plan: ClimbPlan) -> bool:
    """Return whether the spec asks for falls that are counted in closed-loop execution."""
    spec = _read_spec(plan)
    return not isinstance(spec, str) and spec.closed_loop


def _read_spec(plan: ClimbPlan) -> ClimbSpec | TransitionSpec | str:
    """Return the validated spec, or a message if it is invalid."""
    return _validate_text(plan.spec_text, plan.kind)


@lru_cache(maxsize=4)  # several checks ask, and a scan has a thousand regions
def _validate_text(text: str, kind: str) -> ClimbSpec | TransitionSpec | str:
    """Return the validated spec of a text, or a message if it is invalid."""
    try:
        document = parse_yaml(text, "spec")
        spec: ClimbSpec | TransitionSpec | None
        if kind == "climb":
            spec, findings = validate(document, ClimbSpec)
        else:
            from climbplan.climb.schema.transition import TransitionSpec

            spec, findings = validate(document, TransitionSpec)
    except SpecError as error:
        return str(error).splitlines()[0]
    if spec is None:
        return findings[0].message
    return spec


def _compare_task(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    """Yield the differences between the task of the spec and the plan."""
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    yield check_equality("seed", plan.seed == spec.seed)
    num_rounds = task.rounds if isinstance(spec, ClimbSpec) else spec.all_rounds
    last_goal = _select_last_goal(spec)
    yield check_equality("task.rounds", rounds.count == num_rounds)
    yield measure_difference("task.start.com", rounds.com[0], task.start.com)
    yield measure_difference("task.start.rpy_deg", rounds.rpy[0], np.deg2rad(task.start.rpy_deg))
    yield measure_difference("task.goal.com", plan.limits.goal_com, last_goal.com)
    yield measure_difference(
        "task.goal.rpy_deg", plan.limits.goal_rpy, np.deg2rad(last_goal.rpy_deg)
    )
    for key, posture, toes in (
        ("task.start.toes", task.start, rounds.toes[0]),
        ("task.goal.toes", last_goal, plan.limits.goal_toes),
    ):
        for name, toe in posture.toes.items():
            if name not in names:
                yield check_equality(f"{key}.{name}", False)
                continue
            yield _compare_stated_toe(f"{key}.{name}", plan, names.index(name), toes, toe)

    gait = reconstruct_gait(plan)
    if isinstance(spec, ClimbSpec):
        order = [names[i] for i in gait.order()[: len(names)]]
        yield check_equality("task.gait", order == list(spec.task.gait or names))
    if not isinstance(spec, ClimbSpec):
        yield from _compare_transition(plan, spec, gait)
    stood = rounds.toes[gait.foothold_round[::2], np.arange(len(names))]
    lifts = plan.instants.toes[::2] - stood
    height = np.linalg.norm(lifts[plan.instants.lifted[::2]], axis=-1)
    yield measure_difference(
        "trajectory.swing_clearance", height, np.full_like(height, spec.trajectory.swing_clearance)
    )
    span = plan.trajectory.time[-1] - plan.trajectory.time[0]
    rate = (len(plan.trajectory.time) - 1) / span if span > 0 else math.nan
    stated_rate = spec.trajectory.rate
    if spec.trajectory.pace is not None:
        stated_rate = max(stated_rate, MIN_PACED_RATE)
    yield Difference("trajectory.rate", abs(rate / stated_rate - 1))

    # Payload weight at its place on the turned body, and the constant load.
    load = np.tile(
        task.external_wrench.force + task.external_wrench.moment, (len(plan.instants.rpy), 1)
    )
    weight = np.array([0.0, 0.0, -task.payload.mass * plan.robot.gravity])
    arms = np.array(task.payload.offset) @ compute_body_axes(plan.instants.rpy)
    load[:, :3] += weight
    load[:, 3:] += np.cross(arms, weight)
    yield measure_difference(
        "task.payload, task.external_wrench", plan.instants.external_wrench, load
    )


def _compare_stated_toe(
    key: str, plan: ClimbPlan, limb: int, toes: Array, stated: Sequence[float]
) -> Difference:
    """Compare a toe with the point stated for it, which is the contact point for feet of finite
    size.
    """
    toe, point = toes[limb], np.array(stated)
    if plan.robot.foot is None:
        return measure_difference(key, toe, point)
    differences = [
        measure_difference(
            key, toe + plan.robot.foot.radius * -compute_normals(surface, toe[None])[0], point
        )
        for surface, is_allowed in zip(
            plan.terrain.surfaces, plan.terrain.allowed[limb], strict=True
        )
        if is_allowed
    ]
    return min(differences, key=lambda difference: difference.size)


def _select_last_goal(spec: ClimbSpec | TransitionSpec) -> GoalSpec:
    """Return the goal of the whole plan."""
    return spec.task.goal if isinstance(spec, ClimbSpec) else spec.last_goal


def _compare_transition(
    plan: ClimbPlan, spec: TransitionSpec, gait: ClimbGait
) -> Iterator[Difference]:
    """Yield differences in limbs that move together, step lengths, and the gait of the climb."""
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    first = gait.round <= task.rounds
    moving_limbs = gait.moving_limbs[first]
    counts = tuple(int(n) for n in moving_limbs.sum(axis=1))
    yield check_equality("task.sequence", task.moving in ((), counts))
    if task.limbs:
        moved_names = [{names[i] for i in np.flatnonzero(step)} for step in moving_limbs]
        yield check_equality("task.sequence", moved_names == [set(limbs) for limbs in task.limbs])
    num_supporting = len(names) - max(counts, default=0)
    yield Difference(
        "task.min_supporting_limbs", float(max(task.min_supporting_limbs - num_supporting, 0))
    )
    at_end = min(task.rounds, rounds.count)
    transition_toes = rounds.toes[: at_end + 1]
    steps = np.linalg.norm(np.diff(transition_toes, axis=0), axis=-1).max(axis=0)
    for name, largest in task.step_max.items():
        size = float(steps[names.index(name)]) if name in names else math.inf
        yield Difference(f"task.step_max.{name}", max(size - largest, 0.0))
    if spec.climb is None:
        return
    yield measure_difference("task.goal.com", rounds.com[at_end], task.goal.com)
    for name, toe in task.goal.toes.items():
        yield measure_difference(
            f"task.goal.toes.{name}", transition_toes[-1, names.index(name)], toe
        )
    climb = spec.climb.posture.steps
    pose = np.diff(np.hstack([rounds.com, rounds.rpy])[at_end:], axis=0)
    toes = np.linalg.norm(np.diff(rounds.toes[at_end:], axis=0), axis=-1)
    for key, steps_made, max_step in (
        ("com_max", np.linalg.norm(pose[:, :3], axis=1), climb.com_max),
        ("toe_max", toes, climb.toe_max),
        ("rotation_max_deg", np.abs(pose[:, 3:]), math.radians(climb.rotation_max_deg)),
    ):
        excess = float(steps_made.max(initial=0.0)) - max_step
        yield Difference(f"climb.posture.steps.{key}", max(excess, 0.0))
    order = [names[i] for i in gait.order()[~first]]
    single = (gait.moving_limbs[~first].sum(axis=1) == 1).all()
    gaits = list(spec.climb.gait or names) * spec.climb.rounds
    yield check_equality("climb.gait", bool(single) and order == gaits)


def _compare_limits(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    """Yield differences in the bounds of forces, steps and goal."""
    yield from _compare_gripping(plan, spec)
    normal = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    shortfall = spec.force.min_normal_force - normal[plan.instants.contact].min(initial=np.inf)
    is_pressed = spec.force.min_normal_force == 0 or shortfall <= 1e-6 * plan.robot.weight
    yield check_equality("force.min_normal_force", bool(is_pressed))
    deflection = plan.forces.com_deflection
    yield check_equality(
        "force.deflection_compensation",
        spec.force.deflection_compensation == "predicted" or not deflection.any(),
    )
    bounds = _collect_bounds(spec)
    for name, key in BOUNDS.items():
        yield measure_difference(key, vars(plan.limits)[name], bounds[name])


# Bounds that a plan stores, and the keys of the spec that ask for them
BOUNDS = {
    "com_max": "posture.steps.com_max",
    "com_min": "posture.steps.com_min",
    "toe_max": "posture.steps.toe_max",
    "toe_min": "posture.steps.toe_min",
    "rotation_max": "posture.steps.rotation_max_deg",
    "shift_max": "posture.steps.com_shift_max",
    "body_clearance": "posture.body_clearance",
    "goal_tolerance": "task.goal.tolerance",
    "goal_rotation_tolerance": "task.goal.rotation_tolerance_deg",
    "safety_friction": "force.safety_friction",
    "safety_torque": "force.safety_torque",
}


def _collect_bounds(spec: ClimbSpec | TransitionSpec) -> dict[str, Any]:
    """Return the bounds of a spec, by the names in `BOUNDS`."""
    steps, goal = spec.posture.steps, _select_last_goal(spec)
    return {
        "com_max": steps.com_max,
        "com_min": steps.com_min,
        "toe_max": steps.toe_max,
        "toe_min": steps.toe_min,
        "rotation_max": math.radians(steps.rotation_max_deg),
        "shift_max": steps.com_shift_max,
        "body_clearance": spec.posture.body_clearance,
        "goal_tolerance": goal.tolerance,
        "goal_rotation_tolerance": math.radians(goal.rotation_tolerance_deg),
        "safety_friction": spec.force.safety_friction,
        "safety_torque": spec.force.safety_torque,
    }


def _compare_gripping(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    """Yield differences in the use of grippers, for robots that have them."""
    gripper = plan.robot.gripper
    if gripper is None or plan.grips is None:
        return
    if not isinstance(spec, ClimbSpec):
        yield check_equality("robot: grippers", False)
        return
    yield measure_difference("gripper.risk", plan.grips.risk, spec.gripper.risk)
    if spec.gripper.max_force is not None:
        yield measure_difference("gripper.max_force", gripper.max_force, spec.gripper.max_force)


def _check_objective(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Check:
    """Check the posture cost of chapter 5.1.3 at the stored postures, and that no bound is above
    it.
    """
    weights, rounds, limits = spec.posture.weights, plan.rounds, plan.limits
    turn = rounds.rpy[-1] - limits.goal_rpy
    cost = (
        weights.goal * np.sum((rounds.toes[-1] - limits.goal_toes) ** 2)
        + weights.goal_com * np.sum((rounds.com[-1] - limits.goal_com) ** 2)
        + weights.goal_rotation * np.sum(turn**2)
        + weights.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + weights.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + weights.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
    )
    if not isinstance(spec, ClimbSpec):
        cost += spec.posture.weights.effort * np.sum(1 / plan.forces.safety_torque[::2])
    scale = max(abs(cost), 1e-6)
    residual = abs(plan.objective - cost) / scale
    place = f"stored {plan.objective:.6g}, postures cost {cost:.6g}"
    if plan.bound is not None and (plan.bound - cost) / scale > residual:
        residual = (plan.bound - cost) / scale
        place = f"bound {plan.bound:.6g} above the cost {cost:.6g}"
    return judge("file.objective", residual, place)
