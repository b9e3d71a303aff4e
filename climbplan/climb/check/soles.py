"""Checks of flat feet: centres of pressure inside their soles, at the instants and in motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.soles import (
    compute_pressure_centre,
    compute_sole_axes,
    distribute_to_corners,
    measure_beyond_sole,
)
from climbplan.climb.check.friction_factor import compute_friction_factor, format_min_factor
from climbplan.climb.check.motion_forces import MotionForces
from climbplan.climb.check.motion_state import MotionState
from climbplan.climb.check.subject import Subject
from climbplan.robots.foot import Sole
from climbplan.verification.check import Check, judge_worst

PRESSURE_TOLERANCE = 1e-4  # of the weight, pressure of a foot that is just set down or lifted off


def split_pressure_shear(force: Array, normal: Array) -> tuple[Array, Array]:
    """Return pressure and shear (..., 4) of forces at corners (..., 4, 3) on surfaces."""
    pressure = np.einsum("...ci,...i->...c", force, normal)
    shear = force - pressure[..., None] * normal[..., None, :]
    return pressure, np.linalg.norm(shear, axis=-1)


def check_soles(subject: Subject) -> Iterator[Check]:
    """Yield checks of corner forces and centres of pressure; nothing for other feet."""
    plan = subject.plan
    sole, corner_forces, normal = plan.robot.sole, plan.forces.corner_force, plan.instants.normal
    if sole is None or corner_forces is None:
        return
    force_error = (
        np.linalg.norm(corner_forces.sum(axis=-2) - plan.forces.force, axis=-1) / subject.weight
    )
    yield judge_worst("force.corners", force_error, subject.describe_instant)
    wrench = plan.forces.force, subject.contact_moment
    is_pressed = plan.instants.contact & (
        subject.contact_force > PRESSURE_TOLERANCE * subject.weight
    )
    yield _check_pressure_centre(
        "force.soles",
        sole,
        compute_sole_axes(sole, normal),
        wrench,
        is_pressed,
        subject.describe_instant,
    )


def check_soles_in_motion(
    motion: MotionState, motion_forces: MotionForces, mu: Array
) -> Iterator[Check]:
    """Yield checks of centres of pressure in motion, and of friction at the corners of standing
    feet.
    """
    sole, axes, standing = motion.subject.plan.robot.sole, motion.soles, ~motion.lifted
    assert sole is not None
    assert axes is not None
    is_pressed = (axes[..., 2, :] * motion_forces.force).sum(
        axis=-1
    ) > PRESSURE_TOLERANCE * motion.subject.weight
    wrench = motion_forces.force, motion_forces.moment
    yield _check_pressure_centre(
        "trajectory.soles", sole, axes, wrench, standing & is_pressed, motion.describe_sample
    )
    min_force = PRESSURE_TOLERANCE * motion.subject.weight
    corner_forces = distribute_to_corners(
        sole, axes, motion_forces.force, motion_forces.moment, mu, min_force
    )
    pressure, shear = split_pressure_shear(corner_forces, axes[..., 2, :])
    max_shear, weight = mu[..., None] * pressure, motion.subject.weight
    factor = compute_friction_factor("trajectory.friction", shear, max_shear, weight)
    factor = np.where(standing[..., None], factor, np.inf)
    excess = np.maximum(shear - max_shear, -pressure) / weight
    yield judge_worst(
        "trajectory.friction",
        np.where(standing[..., None], excess, -np.inf),
        lambda sample, limb, corner: motion.describe_sample(sample, limb),
        margin=format_min_factor(factor),
        used=1 / np.maximum(factor, 1e-300),
    )


def _check_pressure_centre(
    name: str,
    sole: Sole,
    axes: Array,
    wrench: tuple[Array, Array],
    is_pressed: BoolArray,
    describe_place: Callable[..., str],
) -> Check:
    """Check that centres of pressure of pressed feet (..., N) are inside their soles."""
    edge_excess = measure_beyond_sole(sole, compute_pressure_centre(axes, *wrench))
    edge_excess = np.where(is_pressed, edge_excess, -np.inf)
    inside_mm = -1e3 * float(edge_excess.max(initial=-np.inf))
    margin_text = (
        f"{inside_mm:.1f} mm inside" if inside_mm >= 0 else f"{-inside_mm:.1f} mm beyond the edge"
    )
    half_size = min(sole.length, sole.width) / 2
    return judge_worst(
        name,
        edge_excess,
        describe_place,
        f"centre of pressure {margin_text}",
        used=1 + edge_excess / half_size,
    )
