"""Postures and instants: gait, steps, goal, contacts and kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.check.anew.gait import gait_of
from climbplan.climb.check.convex import polygon_edges, polygon_normal
from climbplan.climb.check.normals import normals_of
from climbplan.climb.check.subject import Subject
from climbplan.robots.joint_units import format_bound_margin
from climbplan.terrain.surfaces import Region, Surface, Tube
from climbplan.verification.check import Check, judge_worst

_LEVEL = 1e-6  # [m] of height in a level shift: rounding


def posture_checks(subject: Subject) -> Iterator[Check]:
    """Everything about postures and instants except forces and clearance."""
    yield _sequence(subject)
    yield from _steps(subject)
    yield from _goal(subject)
    yield from _contacts(subject)
    yield from _kinematics(subject)


def _sequence(subject: Subject) -> Check:
    """Instants are what the gait makes of the rounds: lift, place, push the body on."""
    plan = subject.plan
    instants, rounds = plan.instants, plan.rounds
    gait = gait_of(plan)
    limb = np.arange(plan.robot.limb_count)

    toes = rounds.toes[gait.stood, limb]  # (K, N, 3) where each limb last stood
    off = instants.toes - toes
    # A lifted toe may be anywhere above its old place along the normal, but above it.
    height = np.einsum("kni,kni->kn", off, instants.normal)
    lifted_off = np.linalg.norm(off - height[..., None] * instants.normal, axis=-1)
    lifted_off = np.where(height > 0, lifted_off, np.inf)
    toe_miss = np.where(instants.lifted, lifted_off, np.linalg.norm(off, axis=-1))

    broken = np.where(gait.broken, np.inf, 0.0)[:, None]
    broken = np.maximum(broken, np.where(instants.contact == instants.lifted, np.inf, 0.0))
    wrong = instants.region != rounds.region[gait.stood, limb]
    body = np.linalg.norm(instants.com - gait.com, axis=-1)
    body = np.maximum(body, np.abs(instants.rpy - gait.rpy).max(axis=-1))
    # One radian counts as one metre.
    miss = np.maximum(np.maximum(toe_miss, broken), np.where(wrong, np.inf, body[:, None]))
    # A limb that does not move in a round stands where it stood.
    rests = rounds.toes[gait.stood[1::2], limb] - rounds.toes[gait.round]
    other = rounds.region[gait.stood[1::2], limb] != rounds.region[gait.round]
    ends = np.append(gait.round[1:] != gait.round[:-1], True)[:, None]  # the round's last step
    left = np.where(other, np.inf, np.linalg.norm(rests, axis=-1))
    miss[1::2] = np.maximum(miss[1::2], np.where(ends, left, 0.0))
    return judge_worst("gait.sequence", miss, subject.at)


def _steps(subject: Subject) -> Iterator[Check]:
    """Constraints A and B: bounds on what changes in a round."""
    plan = subject.plan
    limits, rounds = plan.limits, plan.rounds

    def after(j: int, *limb: int) -> str:
        return ", ".join([f"round {j + 1}", *(subject.limb(i) for i in limb)])

    com = np.linalg.norm(np.diff(rounds.com, axis=0), axis=-1)
    toes = np.linalg.norm(np.diff(rounds.toes, axis=0), axis=-1)
    for name, steps, least, largest in (
        ("steps.com", com, limits.com_min, limits.com_max),
        ("steps.toe", toes, limits.toe_min, limits.toe_max),
    ):
        margin = f"{1e3 * steps.max():.0f} of {1e3 * largest:.0f} mm"
        beyond = np.maximum(steps - largest, least - steps)
        yield judge_worst(name, beyond, after, margin, used=steps / largest)
    turns = np.abs(np.diff(rounds.rpy, axis=0)).max(axis=-1)
    margin = f"{np.rad2deg(turns.max()):.1f} of {np.rad2deg(limits.rotation_max):.1f} deg"
    yield judge_worst(
        "steps.rotation",
        turns - limits.rotation_max,
        after,
        margin,
        used=turns / limits.rotation_max,
    )
    if limits.shift_max > 0:
        yield _shift(subject, limits.shift_max)


def _shift(subject: Subject, most: float) -> Check:
    """How far the body is off the straight way between postures at lifts, level."""
    shift = gait_of(subject.plan).shift
    off = np.linalg.norm(shift, axis=-1)
    excess = np.maximum(off - most, np.where(np.abs(shift[:, 2]) > _LEVEL, np.inf, -np.inf))
    margin = f"{1e3 * off.max():.0f} of {1e3 * most:.0f} mm"
    return judge_worst(
        "steps.shift", excess, lambda step: subject.at(2 * step), margin, used=off / most
    )


def _goal(subject: Subject) -> Iterator[Check]:
    """The last posture against the goal."""
    rounds, limits = subject.plan.rounds, subject.plan.limits
    off = np.vstack([rounds.com[-1:] - limits.goal_com, rounds.toes[-1] - limits.goal_toes])
    distance = np.linalg.norm(off, axis=-1)
    names = ("body", *subject.plan.robot.limb_names)
    yield judge_worst(
        "goal.reached",
        distance - limits.goal_tolerance,
        lambda part: names[part],
        f"{1e3 * distance.max():.1f} of {1e3 * limits.goal_tolerance:.1f} mm off",
        used=distance / limits.goal_tolerance,
    )
    turned = np.abs(rounds.rpy[-1] - limits.goal_rpy)
    axes = ("roll", "pitch", "yaw")
    yield judge_worst(
        "goal.rotation",
        turned - limits.goal_rotation_tolerance,
        lambda axis: axes[axis],
        f"{np.rad2deg(turned.max()):.1f} of {np.rad2deg(limits.goal_rotation_tolerance):.1f} deg",
        used=turned / limits.goal_rotation_tolerance,
    )


def _contacts(subject: Subject) -> Iterator[Check]:
    """Every toe on a surface its limb may use, with that surface's normal and friction."""
    plan = subject.plan
    rounds, instants, surfaces = plan.rounds, plan.instants, plan.terrain.surfaces
    stands = _distances(surfaces, rounds.region, rounds.toes)
    touches = np.where(instants.contact, _distances(surfaces, instants.region, instants.toes), 0.0)
    worst = judge_worst(
        "contact.region", stands, lambda j, i: f"{subject.posture(j)}, {subject.limb(i)}"
    )
    at_instants = judge_worst("contact.region", touches, subject.at)
    yield max(worst, at_instants, key=lambda check: check.severity)

    limb = np.arange(plan.robot.limb_count)
    allowed = plan.terrain.allowed
    permitted = np.vstack([allowed[limb, rounds.region], allowed[limb, instants.region]])
    forbidden = np.where(permitted, 0.0, np.count_nonzero(~permitted))
    yield judge_worst(
        "contact.allowed",
        forbidden,
        lambda row, i: (
            (subject.posture(row) if row < len(rounds.com) else subject.at(row - len(rounds.com)))
            + f", {subject.limb(i)}"
        ),
    )

    friction = np.array([surface.friction for surface in surfaces])[instants.region]
    normal = np.empty_like(instants.normal)
    for index, surface in enumerate(surfaces):
        here = instants.region == index
        normal[here] = normals_of(surface, instants.toes[here])
    yield judge_worst(
        "contact.normal", np.linalg.norm(instants.normal - normal, axis=-1), subject.at
    )
    yield judge_worst("contact.friction", np.abs(instants.mu - friction), subject.at)


def _kinematics(subject: Subject) -> Iterator[Check]:
    """Constraint E: the joint angles put the toes where they are; bounds, also of the commands."""
    plan = subject.plan
    robot, instants = plan.robot, plan.instants
    miss = np.linalg.norm(subject.limbs.toe - instants.toes, axis=-1)
    yield judge_worst("kinematics.toes", miss, subject.at)
    over = np.full(instants.joint_angles.shape, -np.inf)
    for angles in (instants.joint_angles, plan.forces.joint_command):
        outside = np.maximum(robot.joint_lower - angles, angles - robot.joint_upper)
        over = np.maximum(over, outside)
    margin = format_bound_margin(robot, over)
    span = (robot.joint_upper - robot.joint_lower) / 2
    yield judge_worst("kinematics.joint_bounds", over, subject.at, margin, used=1 + over / span)


def _distances(surfaces: tuple[Surface, ...], region: IntArray, points: Array) -> Array:
    """How far points (..., 3) are off their surfaces (...) [m], along plane or past an edge."""
    distance = np.full(region.shape, np.nan)
    for index, surface in enumerate(surfaces):
        here = region == index
        p = points[here]
        if isinstance(surface, Region):
            corners = surface.vertices
            normal = polygon_normal(corners)
            outward, offsets = polygon_edges(corners, normal)
            past = (p @ outward.T - offsets).max(axis=-1, initial=-np.inf)
            distance[here] = np.maximum(np.abs((p - corners[0]) @ normal), past)
        elif isinstance(surface, Tube):
            radial = np.abs(np.hypot(*(p[:, :2] - surface.center).T) - surface.radius)
            past = np.maximum(surface.lower - p[:, 2], p[:, 2] - surface.upper)
            distance[here] = np.maximum(radial, past)
    return np.where(distance < 0, 0.0, distance)
