"""Contact forces with their friction cones at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan

RING_POINTS = 40


@dataclass(frozen=True)
class FrictionConeView:
    """One limb's force on the robot and its cone cut at the height of the normal force.

    The force's tip lies in the cut: inside the inner ring it keeps S_mu, inside the outer it holds.
    """

    limb: int
    toe: Array  # (3,) [m]
    tip: Array  # (3,) [m] at the picture's scale
    outer: Array  # (RING_POINTS, 3) ring of mu
    inner: Array  # (RING_POINTS, 3) ring of mu / S_mu
    magnitude: float  # [N]


def compute_tangents(normal: Array) -> Array:
    """Return two unit vectors (2, 3) at right angles to a unit normal and to each other."""
    seed = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, seed)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def compute_contact_forces(plan: ClimbPlan, k: int, scale: float) -> tuple[FrictionConeView, ...]:
    """Return forces of the limbs in contact at instant k; scale in metres a newton."""
    instants, force = plan.instants, plan.forces.force[k]
    angle = np.linspace(0, 2 * np.pi, RING_POINTS, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])  # (RING_POINTS, 2)
    forces = []
    for limb in np.flatnonzero(instants.contact[k]):
        toe, normal, mu = instants.toes[k, limb], instants.normal[k, limb], instants.mu[k, limb]
        pressing = max(float(normal @ force[limb]), 0.0)
        if plan.grips is not None:
            pressing = 0.0  # a grip holds by its fingers: no cone about the normal tells it
        ring = circle @ compute_tangents(normal)
        center = toe + scale * pressing * normal
        radius = scale * pressing * mu
        forces.append(
            FrictionConeView(
                limb=int(limb),
                toe=toe,
                tip=toe + scale * force[limb],
                outer=center + radius * ring,
                inner=center + radius / plan.limits.safety_friction * ring,
                magnitude=float(np.linalg.norm(force[limb])),
            )
        )
    return tuple(forces)


def compute_force_scale(plan: ClimbPlan, longest: float) -> float:
    """Return metres a newton at which the largest force of the plan is `longest` metres long."""
    largest = float(np.linalg.norm(plan.forces.force, axis=-1).max())
    return longest / largest if largest > 0 else 0.0


def select_round_force(scale: float, length: float) -> float:
    """Return the largest force of 1, 2 or 5 times a power of ten that is at most `length` metres
    long.
    """
    if scale <= 0:
        return 0.0
    max_newtons = length / scale
    power = 10.0 ** np.floor(np.log10(max_newtons))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= max_newtons))
