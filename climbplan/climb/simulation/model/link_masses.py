"""Masses and inertias of a robot's links in a simulation.

Links of robots from URDFs have the masses that the plan contains. Those of other robots share a
fraction of the total evenly, as their plans count all mass to the body.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.link_masses import LinkMasses
from climbplan.simulation.conditions import Conditions

_MIN_MASS = 1e-4  # [kg] of a body, for MuJoCo
_MIN_INERTIA = 1e-7  # [kg m^2] about any axis


def select_link_masses(plan: ClimbPlan, conditions: Conditions) -> LinkMasses | None:
    """Select the link masses of a plan, bounded to what MuJoCo can integrate.

    None if the plan has none, or if the conditions state a fraction for the limbs.
    """
    links = plan.robot.links
    if conditions.limb_mass_share is not None or links is None:
        return None
    mass = np.maximum(links.mass, _MIN_MASS)
    return replace(
        links,
        mass=mass,
        inertia=_bound_inertia(links.inertia),
        body_mass=plan.robot.mass - float(mass.sum()),
        body_inertia=_bound_inertia(links.body_inertia),
    )


def _bound_inertia(inertia: Array) -> Array:
    """Bound the principal moments of inertias (..., 3, 3) from below, for MuJoCo's integration."""
    value, vector = np.linalg.eigh((inertia + np.swapaxes(inertia, -1, -2)) / 2)
    value = np.maximum(value, _MIN_INERTIA)
    return np.asarray((vector * value[..., None, :]) @ np.swapaxes(vector, -1, -2))
