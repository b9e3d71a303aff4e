"""Flat feet: pressed inside their soles, at the instants and on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.check.anew.soles import (
    beyond_sole,
    centre_of_pressure,
    corner_forces,
    lying,
)
from climbplan.climb.check.friction_factor import friction_factor, least_factor
from climbplan.climb.check.motion_forces import MotionForces
from climbplan.climb.check.motion_state import Motion
from climbplan.climb.check.subject import Subject
from climbplan.robots.foot import Sole
from climbplan.verification.check import Check, judge_worst

NONE = 1e-4  # of the weight, pressure of a foot that is just set down or lifted off


def parted(force: Array, normal: Array) -> tuple[Array, Array]:
    """Pressure and size of the shear (..., 4) of forces at corners (..., 4, 3) on surfaces."""
    pressure = np.einsum("...ci,...i->...c", force, normal)
    shear = force - pressure[..., None] * normal[..., None, :]
    return pressure, np.linalg.norm(shear, axis=-1)


def sole_checks(subject: Subject) -> Iterator[Check]:
    """Forces at corners make those of feet, and centres of pressure are inside soles.

    Nothing for other feet.
    """
    plan = subject.plan
    sole, pushes, normal = plan.robot.sole, plan.forces.corner_force, plan.instants.normal
    if sole is None or pushes is None:
        return
    off = np.linalg.norm(pushes.sum(axis=-2) - plan.forces.force, axis=-1) / subject.weight
    yield judge_worst("force.corners", off, subject.at)
    wrench = plan.forces.force, subject.held_moment
    pressed = plan.instants.contact & (subject.contact_force > NONE * subject.weight)
    yield _inside("force.soles", sole, lying(sole, normal), wrench, pressed, subject.at)


def sole_motion_checks(motion: Motion, found: MotionForces, mu: Array) -> Iterator[Check]:
    """The same on the way, and friction at corners of the feet that stand there."""
    sole, axes, standing = motion.subject.plan.robot.sole, motion.soles, ~motion.lifted
    assert sole is not None
    assert axes is not None
    pressing = (axes[..., 2, :] * found.force).sum(axis=-1) > NONE * motion.subject.weight
    wrench = found.force, found.moment
    yield _inside("trajectory.soles", sole, axes, wrench, standing & pressing, motion.at)
    least = NONE * motion.subject.weight
    pushes = corner_forces(sole, axes, found.force, found.moment, mu, least)
    pressure, shear = parted(pushes, axes[..., 2, :])
    held, weight = mu[..., None] * pressure, motion.subject.weight
    factor = friction_factor("trajectory.friction", shear, held, weight)
    factor = np.where(standing[..., None], factor, np.inf)
    excess = np.maximum(shear - held, -pressure) / weight
    yield judge_worst(
        "trajectory.friction",
        np.where(standing[..., None], excess, -np.inf),
        lambda sample, limb, corner: motion.at(sample, limb),
        margin=least_factor(factor),
        used=1 / np.maximum(factor, 1e-300),
    )


def _inside(
    name: str,
    sole: Sole,
    axes: Array,
    wrench: tuple[Array, Array],
    pressed: BoolArray,
    at: Callable[..., str],
) -> Check:
    """Centres of pressure inside soles, of feet (..., N) that are pressed on."""
    beyond = beyond_sole(sole, centre_of_pressure(axes, *wrench))
    beyond = np.where(pressed, beyond, -np.inf)
    inside = -1e3 * float(beyond.max(initial=-np.inf))
    words = f"{inside:.1f} mm inside" if inside >= 0 else f"{-inside:.1f} mm beyond the edge"
    half = min(sole.length, sole.width) / 2
    return judge_worst(name, beyond, at, f"centre of pressure {words}", used=1 + beyond / half)
