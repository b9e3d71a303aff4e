"""The plan answers the spec it carries: bounds, loads, robot, terrain and objective are the spec's.

The terrain is looked at twice: corner by corner, and as planning builds it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.check.anew.gait import Gait, gait_of
from climbplan.climb.check.anew.kinematics import body_axes
from climbplan.climb.check.anew.spec import built_anew
from climbplan.climb.check.normals import normals_of
from climbplan.climb.check.subject import Subject
from climbplan.climb.check.terrain import terrain_differences
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.schema.model import ClimbSpec, GoalSpec
from climbplan.errors import SpecError
from climbplan.schema.holding import HeldSpec
from climbplan.schema.kinds import validate
from climbplan.schema.robots.source import AnyRobot
from climbplan.schema.yaml_source import parse_yaml
from climbplan.verification.check import Check, judge, judge_worst, unjudged
from climbplan.verification.differences import Difference, apart, same

if TYPE_CHECKING:
    from climbplan.climb.schema.transition import TransitionSpec


def inward_check(subject: Subject, asked: float | None) -> Check:
    """Depth of commands by n . J (angles - commands) >= asked [m].

    A joint that is a spring is commanded beyond its angle by what the contact force bends it. Shear
    bends limbs as well, and where it does so away from the surface by more than pressure does
    towards it, the commanded toe is off the surface: friction alone holds it there, and a toe that
    touches down a little late, or slides once, never finds the surface.

    This is to first order, as plans are asked for it; beside it stands how deep the commanded toes
    really are, which is what reports call the depth of commands. Commands outside are told but not
    judged where the spec asks nothing.
    """
    instants, forces = subject.plan.instants, subject.plan.forces
    bent = instants.joint_angles - forces.joint_command
    moved = np.einsum("knij,knj->kni", subject.limbs.jacobian(), bent)
    depth = np.einsum("kni,kni->kn", moved, instants.normal)
    standing = np.where(instants.contact, depth, np.inf)
    outside = int((standing < 0).sum())
    into = np.einsum("kni,kni->kn", instants.toes - forces.toe_command, instants.normal)
    real = np.where(instants.contact, into, np.inf)
    linear, commanded = _millimetres(standing), _millimetres(real)
    margin = f"{linear} inside at least to first order, {commanded} as commanded"
    if outside:
        margin += f", {outside} of {int(instants.contact.sum())} commands outside"
    residual = np.where(instants.contact, (asked or 0.0) - depth, -np.inf)
    check = judge_worst("force.inward", residual, subject.at, margin=margin)
    if asked is not None or check.passed:
        return check
    # Nothing is left out of the plan: what friction has to hold is judged by the static checks.
    return unjudged(check, "force.least_depth is not asked")


def _millimetres(depth: np.ndarray) -> str:
    """The least of depths [m] in words, without "-0.0"."""
    return f"{round(1e3 * float(depth.min(initial=np.inf)), 1) + 0.0:.1f} mm"


def spec_checks(subject: Subject, robot: AnyRobot | None = None) -> Iterator[Check]:
    """The plan's spec against its numbers; robot: in place of the one that the plan carries."""
    plan = subject.plan
    spec = _spec_of(plan)
    if isinstance(spec, str):
        yield judge("file.spec_values", math.inf, spec)
        return
    differences = [*_task(plan, spec), *_limits(plan, spec), *terrain_differences(plan, spec)]
    worst = max(differences, key=lambda d: math.inf if math.isnan(d.size) else d.size)
    yield judge("file.spec_values", worst.size, worst.key if worst.size > 0 else "")
    yield from built_anew(plan, spec, robot)
    yield _objective(plan, spec)
    if plan.robot.gripper is None:
        yield inward_check(subject, spec.force.least_depth)


def answering(plan: ClimbPlan, held: HeldSpec) -> ClimbPlan:
    """The plan as an answer to another spec: its bounds are what that one asks for."""
    other = replace(plan, spec_text=held.text)
    spec = _spec_of(other)
    if isinstance(spec, str):
        return other  # `spec_checks` says what is wrong with it
    return replace(other, limits=replace(plan.limits, **_bounds(spec)))


def margins_of(plan: ClimbPlan) -> MarginsSpec | None:
    """The margins that the plan's spec asks for; None for none, or where it is no spec."""
    spec = _spec_of(plan)
    if isinstance(spec, str):
        return None
    gripping = plan.robot.gripper is not None
    asked = spec.margins.asked_of_grips if gripping else spec.margins.asked
    return spec.margins if asked else None


def risk_of(plan: ClimbPlan) -> float | None:
    """The largest probability of a fall that the plan's spec allows; None where it says nothing."""
    spec = _spec_of(plan)
    return None if isinstance(spec, str) else spec.risk


def _spec_of(plan: ClimbPlan) -> ClimbSpec | TransitionSpec | str:
    """The validated spec, or what is wrong with it."""
    return _validated(plan.spec_text, plan.kind)


@lru_cache(maxsize=4)  # several checks ask, and a scan has a thousand regions
def _validated(text: str, kind: str) -> ClimbSpec | TransitionSpec | str:
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


def _task(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    yield same("seed", plan.seed == spec.seed)
    whole = task.rounds if isinstance(spec, ClimbSpec) else spec.all_rounds
    last = _last_goal(spec)
    yield same("task.rounds", rounds.count == whole)
    yield apart("task.start.com", rounds.com[0], task.start.com)
    yield apart("task.start.rpy_deg", rounds.rpy[0], np.deg2rad(task.start.rpy_deg))
    yield apart("task.goal.com", plan.limits.goal_com, last.com)
    yield apart("task.goal.rpy_deg", plan.limits.goal_rpy, np.deg2rad(last.rpy_deg))
    for key, posture, toes in (
        ("task.start.toes", task.start, rounds.toes[0]),
        ("task.goal.toes", last, plan.limits.goal_toes),
    ):
        for name, toe in posture.toes.items():
            if name not in names:
                yield same(f"{key}.{name}", False)
                continue
            yield _stated_toe_apart(f"{key}.{name}", plan, names.index(name), toes, toe)

    gait = gait_of(plan)
    if isinstance(spec, ClimbSpec):
        order = [names[i] for i in gait.order()[: len(names)]]
        yield same("task.gait", order == list(spec.task.gait or names))
    if not isinstance(spec, ClimbSpec):
        yield from _transition(plan, spec, gait)
    stood = rounds.toes[gait.stood[::2], np.arange(len(names))]
    lifts = plan.instants.toes[::2] - stood
    height = np.linalg.norm(lifts[plan.instants.lifted[::2]], axis=-1)
    yield apart("trajectory.lift", height, np.full_like(height, spec.trajectory.lift))
    span = plan.trajectory.time[-1] - plan.trajectory.time[0]
    rate = (len(plan.trajectory.time) - 1) / span if span > 0 else math.nan
    yield Difference("trajectory.rate", abs(rate / spec.trajectory.rate - 1))

    # Payload weight at its place on the turned body, and the constant load.
    load = np.tile(
        task.external_wrench.force + task.external_wrench.moment, (len(plan.instants.rpy), 1)
    )
    weight = np.array([0.0, 0.0, -task.payload.mass * plan.robot.gravity])
    arms = np.array(task.payload.offset) @ body_axes(plan.instants.rpy)
    load[:, :3] += weight
    load[:, 3:] += np.cross(arms, weight)
    yield apart("task.payload, task.external_wrench", plan.instants.external_wrench, load)


def _stated_toe_apart(
    key: str, plan: ClimbPlan, limb: int, toes: Array, stated: Sequence[float]
) -> Difference:
    """A toe against the point stated for it; of a foot of finite size that is where it touches."""
    toe, point = toes[limb], np.array(stated)
    if plan.robot.foot is None:
        return apart(key, toe, point)
    off = [
        apart(key, toe + plan.robot.foot.radius * -normals_of(surface, toe[None])[0], point)
        for surface, may in zip(plan.terrain.surfaces, plan.terrain.allowed[limb], strict=True)
        if may
    ]
    return min(off, key=lambda difference: difference.size)


def _last_goal(spec: ClimbSpec | TransitionSpec) -> GoalSpec:
    """The goal of the whole plan."""
    return spec.task.goal if isinstance(spec, ClimbSpec) else spec.last_goal


def _transition(plan: ClimbPlan, spec: TransitionSpec, gait: Gait) -> Iterator[Difference]:
    """Which limbs move together, how far, and the gait of a climb that follows."""
    task, rounds, names = spec.task, plan.rounds, plan.robot.limb_names
    first = gait.round <= task.rounds
    moved = gait.moved[first]
    counts = tuple(int(n) for n in moved.sum(axis=1))
    yield same("task.sequence", task.moving in ((), counts))
    if task.limbs:
        named = [{names[i] for i in np.flatnonzero(step)} for step in moved]
        yield same("task.sequence", named == [set(limbs) for limbs in task.limbs])
    left = len(names) - max(counts, default=0)
    yield Difference("task.supporting", float(max(task.supporting - left, 0)))
    at_end = min(task.rounds, rounds.count)
    own = rounds.toes[: at_end + 1]
    steps = np.linalg.norm(np.diff(own, axis=0), axis=-1).max(axis=0)
    for name, largest in task.step_max.items():
        size = float(steps[names.index(name)]) if name in names else math.inf
        yield Difference(f"task.step_max.{name}", max(size - largest, 0.0))
    if spec.climb is None:
        return
    yield apart("task.goal.com", rounds.com[at_end], task.goal.com)
    for name, toe in task.goal.toes.items():
        yield apart(f"task.goal.toes.{name}", own[-1, names.index(name)], toe)
    climb = spec.climb.posture.steps
    pose = np.diff(np.hstack([rounds.com, rounds.rpy])[at_end:], axis=0)
    toes = np.linalg.norm(np.diff(rounds.toes[at_end:], axis=0), axis=-1)
    for key, made, most in (
        ("com_max", np.linalg.norm(pose[:, :3], axis=1), climb.com_max),
        ("toe_max", toes, climb.toe_max),
        ("rotation_max_deg", np.abs(pose[:, 3:]), math.radians(climb.rotation_max_deg)),
    ):
        excess = float(made.max(initial=0.0)) - most
        yield Difference(f"climb.posture.steps.{key}", max(excess, 0.0))
    order = [names[i] for i in gait.order()[~first]]
    single = (gait.moved[~first].sum(axis=1) == 1).all()
    gaits = list(spec.climb.gait or names) * spec.climb.rounds
    yield same("climb.gait", bool(single) and order == gaits)


def _limits(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    yield from _gripping(plan, spec)
    normal = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    missing = spec.force.least_pressure - normal[plan.instants.contact].min(initial=np.inf)
    pressed = spec.force.least_pressure == 0 or missing <= 1e-6 * plan.robot.weight
    yield same("force.least_pressure", bool(pressed))
    sag = plan.forces.com_deflection
    yield same("force.sag", spec.force.sag == "predicted" or not sag.any())
    asked = _bounds(spec)
    for name, key in BOUNDS.items():
        yield apart(key, vars(plan.limits)[name], asked[name])


# Bounds that a plan stores, and the keys of the spec that ask for them
BOUNDS = {
    "com_max": "posture.steps.com_max",
    "com_min": "posture.steps.com_min",
    "toe_max": "posture.steps.toe_max",
    "toe_min": "posture.steps.toe_min",
    "rotation_max": "posture.steps.rotation_max_deg",
    "shift_max": "posture.steps.shift_max",
    "body_clearance": "posture.body_clearance",
    "goal_tolerance": "task.goal.tolerance",
    "goal_rotation_tolerance": "task.goal.rotation_tolerance_deg",
    "safety_friction": "force.safety_friction",
    "safety_torque": "force.safety_torque",
}


def _bounds(spec: ClimbSpec | TransitionSpec) -> dict[str, Any]:
    """What a spec asks for, by the names in `BOUNDS`."""
    steps, goal = spec.posture.steps, _last_goal(spec)
    return {
        "com_max": steps.com_max,
        "com_min": steps.com_min,
        "toe_max": steps.toe_max,
        "toe_min": steps.toe_min,
        "rotation_max": math.radians(steps.rotation_max_deg),
        "shift_max": steps.shift_max,
        "body_clearance": spec.posture.body_clearance,
        "goal_tolerance": goal.tolerance,
        "goal_rotation_tolerance": math.radians(goal.rotation_tolerance_deg),
        "safety_friction": spec.force.safety_friction,
        "safety_torque": spec.force.safety_torque,
    }


def _gripping(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Iterator[Difference]:
    """How grippers are used, by robots that have them."""
    gripper = plan.robot.gripper
    if gripper is None or plan.grips is None:
        return
    if not isinstance(spec, ClimbSpec):
        yield same("robot: grippers", False)
        return
    yield apart("gripper.risk", plan.grips.risk, spec.gripper.risk)
    if spec.gripper.max_force is not None:
        yield apart("gripper.max_force", gripper.max_force, spec.gripper.max_force)


def _objective(plan: ClimbPlan, spec: ClimbSpec | TransitionSpec) -> Check:
    """The posture cost of chapter 5.1.3 at the stored postures; no bound above it."""
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
