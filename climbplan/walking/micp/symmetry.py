"""Symmetry breaking: of two motions that are mirror images of each other one is enough.

If a task is its own mirror image about the plane of x and z, and so is the attitude box, the image
of each motion costs the same and is in the box as well. A bound on motions whose first contact that
differs from its image belongs to a left leg is then a bound on all motions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.attitude_box import AttitudeBox
from climbplan.walking.micp.linear_model import LinExpr, sum_expressions
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.task.task import WalkTask

_MIRROR_VECTOR = np.array([1.0, -1.0, 1.0])  # image of a position, velocity or force
_MIRROR_ROTATION = -_MIRROR_VECTOR  # image of angles and angular velocities
_MIRROR_STATE = np.concatenate([_MIRROR_VECTOR, _MIRROR_VECTOR, _MIRROR_ROTATION, _MIRROR_ROTATION])
_MAX_WIDENING = 0.1  # of the half width, by which a box may grow to contain its image
_COMPARED_PAIRS = 8  # of legs: the weight of each is half of that of the one before


def is_mirror_symmetric(task: WalkTask) -> bool:
    """Return whether the image of each motion costs the same and satisfies the same rows."""
    body, ground, reference, goal = task.body, task.ground, task.reference, task.goal
    if ground.corners.size or ground.allowed.size or ground.scan is not None:
        return False
    swapped = np.arange(body.leg_count) ^ 1  # legs are in pairs, the left one first
    with_image = (
        (body.toe_center, body.toe_center[swapped] * _MIRROR_VECTOR),
        (body.inertia, body.inertia * np.outer(_MIRROR_VECTOR, _MIRROR_VECTOR)),
        (ground.lower[:, 1], -ground.upper[:, 1]),
        (task.start.state, task.start.state * _MIRROR_STATE),
        (task.start.toes, task.start.toes[swapped] * _MIRROR_VECTOR),
        (reference.velocity, reference.velocity * _MIRROR_VECTOR),
        (reference.euler, reference.euler * _MIRROR_ROTATION),
        (goal.lower[1], -goal.upper[1]),
    )
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in with_image)


def include_mirror_images(
    attitude_box: AttitudeBox, angles: Array, omega: Array
) -> AttitudeBox | None:
    """Widen an attitude box to contain the images of its motions.

    Args:
        attitude_box: The box.
        angles: Half widths about the motions (3,) [rad].
        omega: Half widths of angular velocities about the motions (3,) [rad/s].

    Returns:
        The symmetric box; None if it would be much wider.
    """
    shift, omega_shift = (
        np.where(_MIRROR_ROTATION < 0, middle, 0.0)
        for middle in (attitude_box.angles, attitude_box.omega)
    )
    if (np.abs(shift) > _MAX_WIDENING * angles).any() or (
        np.abs(omega_shift[:-1]) > _MAX_WIDENING * omega
    ).any():
        return None
    return replace(
        attitude_box,
        angles=attitude_box.angles - shift,
        angles_half=attitude_box.angles_half + np.abs(shift),
        omega=attitude_box.omega - omega_shift,
        omega_half=attitude_box.omega_half + np.abs(omega_shift),
        heading=attitude_box.heading - shift[:, 2],
    )


def build_symmetry_breaker(program: MixedIntegerRelaxation) -> LinExpr:
    """Return an expression that is at least 0 for one motion of each mirrored pair.

    It orders contacts lexicographically: the first leg that stands without its image is a left one.
    """
    contacts = [
        sum_expressions(q.indicator for q in leg) for legs in program.pieces for leg in legs
    ]
    pairs = list(zip(contacts[::2], contacts[1::2], strict=True))[:_COMPARED_PAIRS]
    return sum_expressions((left - right) * 0.5**k for k, (left, right) in enumerate(pairs))
