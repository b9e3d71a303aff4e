"""Checks of postures and instants: gait, steps, goal, contacts and kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.check.anew.gait import reconstruct_gait
from climbplan.climb.check.convex import compute_polygon_edges, compute_polygon_normal
from climbplan.climb.check.normals import compute_normals
from climbplan.climb.check.subject import Subject
from climbplan.robots.joint_units import format_bound_margin
from climbplan.terrain.surfaces import Region, Surface, Tube
from climbplan.verification.check import Check, judge_worst

_HEIGHT_TOLERANCE = 1e-6  # [m] of height in a level shift: rounding


def check_postures(subject: Subject) -> Iterator[Check]:
    """Yield all checks of postures and instants except forces and clearance."""
    yield _check_sequence(subject)
    yield from _check_steps(subject)
    yield from _check_goal(subject)
    yield from _check_contacts(subject)
    yield from _check_kinematics(subject)


def _check_sequence(subject: Subject) -> Check:
    """Check that instants follow from gait and rounds: lift, place, push the body on."""
    plan = subject.plan
    instants, rounds = plan.instants, plan.rounds
    gait = reconstruct_gait(plan)
    limb = np.arange(plan.robot.limb_count)

    toes = rounds.toes[gait.foothold_round, limb]  # (K, N, 3) where each limb last stood
    toe_offset = instants.toes - toes
    # A lifted toe may be anywhere above its old place along the normal, but above it.
    height = np.einsum("kni,kni->kn", toe_offset, instants.normal)
    lateral_offset = np.linalg.norm(toe_offset - height[..., None] * instants.normal, axis=-1)
    lateral_offset = np.where(height > 0, lateral_offset, np.inf)
    toe_error = np.where(instants.lifted, lateral_offset, np.linalg.norm(toe_offset, axis=-1))

    sequence_error = np.where(gait.is_invalid, np.inf, 0.0)[:, None]
    sequence_error = np.maximum(
        sequence_error, np.where(instants.contact == instants.lifted, np.inf, 0.0)
    )
    is_wrong_region = instants.region != rounds.region[gait.foothold_round, limb]
    body_error = np.linalg.norm(instants.com - gait.com, axis=-1)
    body_error = np.maximum(body_error, np.abs(instants.rpy - gait.rpy).max(axis=-1))
    # One radian counts as one metre.
    error = np.maximum(
        np.maximum(toe_error, sequence_error),
        np.where(is_wrong_region, np.inf, body_error[:, None]),
    )
    # A limb that does not move in a round stands where it stood.
    resting_offset = rounds.toes[gait.foothold_round[1::2], limb] - rounds.toes[gait.round]
    is_other_region = rounds.region[gait.foothold_round[1::2], limb] != rounds.region[gait.round]
    is_last_step = np.append(gait.round[1:] != gait.round[:-1], True)[
        :, None
    ]  # the round's last step
    resting_error = np.where(is_other_region, np.inf, np.linalg.norm(resting_offset, axis=-1))
    error[1::2] = np.maximum(error[1::2], np.where(is_last_step, resting_error, 0.0))
    return judge_worst("gait.sequence", error, subject.describe_instant)


def _check_steps(subject: Subject) -> Iterator[Check]:
    """Check constraints A and B: bounds on the changes in a round."""
    plan = subject.plan
    limits, rounds = plan.limits, plan.rounds

    def describe_round(j: int, *limb: int) -> str:
        return ", ".join([f"round {j + 1}", *(subject.name_limb(i) for i in limb)])

    com = np.linalg.norm(np.diff(rounds.com, axis=0), axis=-1)
    toes = np.linalg.norm(np.diff(rounds.toes, axis=0), axis=-1)
    for name, steps, min_step, max_step in (
        ("steps.com", com, limits.com_min, limits.com_max),
        ("steps.toe", toes, limits.toe_min, limits.toe_max),
    ):
        margin = f"{1e3 * steps.max():.0f} of {1e3 * max_step:.0f} mm"
        excess = np.maximum(steps - max_step, min_step - steps)
        yield judge_worst(name, excess, describe_round, margin, used=steps / max_step)
    rotation_steps = np.abs(np.diff(rounds.rpy, axis=0)).max(axis=-1)
    margin = f"{np.rad2deg(rotation_steps.max()):.1f} of {np.rad2deg(limits.rotation_max):.1f} deg"
    yield judge_worst(
        "steps.rotation",
        rotation_steps - limits.rotation_max,
        describe_round,
        margin,
        used=rotation_steps / limits.rotation_max,
    )
    if limits.shift_max > 0:
        yield _check_shift(subject, limits.shift_max)


def _check_shift(subject: Subject, max_shift: float) -> Check:
    """Check how far the body is off the straight line between postures at lifts, horizontally."""
    shift = reconstruct_gait(subject.plan).shift
    shift_norm = np.linalg.norm(shift, axis=-1)
    excess = np.maximum(
        shift_norm - max_shift, np.where(np.abs(shift[:, 2]) > _HEIGHT_TOLERANCE, np.inf, -np.inf)
    )
    margin = f"{1e3 * shift_norm.max():.0f} of {1e3 * max_shift:.0f} mm"
    return judge_worst(
        "steps.shift",
        excess,
        lambda step: subject.describe_instant(2 * step),
        margin,
        used=shift_norm / max_shift,
    )


def _check_goal(subject: Subject) -> Iterator[Check]:
    """Check the last posture against the goal."""
    rounds, limits = subject.plan.rounds, subject.plan.limits
    goal_offset = np.vstack([rounds.com[-1:] - limits.goal_com, rounds.toes[-1] - limits.goal_toes])
    distance = np.linalg.norm(goal_offset, axis=-1)
    names = ("body", *subject.plan.robot.limb_names)
    yield judge_worst(
        "goal.position",
        distance - limits.goal_tolerance,
        lambda part: names[part],
        f"{1e3 * distance.max():.1f} of {1e3 * limits.goal_tolerance:.1f} mm off",
        used=distance / limits.goal_tolerance,
    )
    rotation_error = np.abs(rounds.rpy[-1] - limits.goal_rpy)
    axes = ("roll", "pitch", "yaw")
    yield judge_worst(
        "goal.rotation",
        rotation_error - limits.goal_rotation_tolerance,
        lambda axis: axes[axis],
        f"{np.rad2deg(rotation_error.max()):.1f} of "
        f"{np.rad2deg(limits.goal_rotation_tolerance):.1f} deg",
        used=rotation_error / limits.goal_rotation_tolerance,
    )


def _check_contacts(subject: Subject) -> Iterator[Check]:
    """Check that every toe is on an allowed surface, with that surface's normal and friction."""
    plan = subject.plan
    rounds, instants, surfaces = plan.rounds, plan.instants, plan.terrain.surfaces
    round_distances = _measure_surface_distances(surfaces, rounds.region, rounds.toes)
    instant_distances = np.where(
        instants.contact, _measure_surface_distances(surfaces, instants.region, instants.toes), 0.0
    )
    worst = judge_worst(
        "contact.region",
        round_distances,
        lambda j, i: f"{subject.describe_posture(j)}, {subject.name_limb(i)}",
    )
    at_instants = judge_worst("contact.region", instant_distances, subject.describe_instant)
    yield max(worst, at_instants, key=lambda check: check.severity)

    limb = np.arange(plan.robot.limb_count)
    allowed = plan.terrain.allowed
    permitted = np.vstack([allowed[limb, rounds.region], allowed[limb, instants.region]])
    forbidden = np.where(permitted, 0.0, np.count_nonzero(~permitted))
    yield judge_worst(
        "contact.allowed",
        forbidden,
        lambda row, i: (
            (
                subject.describe_posture(row)
                if row < len(rounds.com)
                else subject.describe_instant(row - len(rounds.com))
            )
            + f", {subject.name_limb(i)}"
        ),
    )

    friction = np.array([surface.friction for surface in surfaces])[instants.region]
    normal = np.empty_like(instants.normal)
    for index, surface in enumerate(surfaces):
        on_surface = instants.region == index
        normal[on_surface] = compute_normals(surface, instants.toes[on_surface])
    yield judge_worst(
        "contact.normal",
        np.linalg.norm(instants.normal - normal, axis=-1),
        subject.describe_instant,
    )
    yield judge_worst("contact.friction", np.abs(instants.mu - friction), subject.describe_instant)


def _check_kinematics(subject: Subject) -> Iterator[Check]:
    """Check constraint E: joint angles reach the toes; angles and commands are within bounds."""
    plan = subject.plan
    robot, instants = plan.robot, plan.instants
    toe_error = np.linalg.norm(subject.limbs.toe - instants.toes, axis=-1)
    yield judge_worst("kinematics.forward", toe_error, subject.describe_instant)
    bound_violation = np.full(instants.joint_angles.shape, -np.inf)
    for angles in (instants.joint_angles, plan.forces.joint_command):
        violation = np.maximum(robot.joint_lower - angles, angles - robot.joint_upper)
        bound_violation = np.maximum(bound_violation, violation)
    margin = format_bound_margin(robot, bound_violation)
    half_range = (robot.joint_upper - robot.joint_lower) / 2
    yield judge_worst(
        "kinematics.joint_bounds",
        bound_violation,
        subject.describe_instant,
        margin,
        used=1 + bound_violation / half_range,
    )


def _measure_surface_distances(
    surfaces: tuple[Surface, ...], region: IntArray, points: Array
) -> Array:
    """Return how far points (..., 3) are off their surfaces (...) [m], off the plane or past an
    edge.
    """
    distance = np.full(region.shape, np.nan)
    for index, surface in enumerate(surfaces):
        on_surface = region == index
        surface_points = points[on_surface]
        if isinstance(surface, Region):
            corners = surface.vertices
            normal = compute_polygon_normal(corners)
            outward, offsets = compute_polygon_edges(corners, normal)
            edge_violation = (surface_points @ outward.T - offsets).max(axis=-1, initial=-np.inf)
            distance[on_surface] = np.maximum(
                np.abs((surface_points - corners[0]) @ normal), edge_violation
            )
        elif isinstance(surface, Tube):
            radial = np.abs(np.hypot(*(surface_points[:, :2] - surface.center).T) - surface.radius)
            edge_violation = np.maximum(
                surface.lower - surface_points[:, 2], surface_points[:, 2] - surface.upper
            )
            distance[on_surface] = np.maximum(radial, edge_violation)
    return np.where(distance < 0, 0.0, distance)
