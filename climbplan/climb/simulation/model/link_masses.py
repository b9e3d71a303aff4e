"""What each link of a climbing robot weighs in a simulation, and where.

Links of robots from URDFs weigh what the plan says of them. Those of other robots weigh a share of
the whole, spread evenly: their plans count all mass to the body.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.robots.link_masses import LinkMasses
from climbplan.simulation.conditions import Conditions

_LEAST = 1e-4  # [kg] of a body, for MuJoCo
_LEAST_INERTIA = 1e-7  # [kg m^2] about any axis


def link_masses(plan: ClimbPlan, conditions: Conditions) -> LinkMasses | None:
    """Of the links that a plan carries, as bodies that can be simulated.

    None where it carries none, and where a share is given.
    """
    links = plan.robot.links
    if conditions.limb_mass_share is not None or links is None:
        return None
    mass = np.maximum(links.mass, _LEAST)
    return replace(
        links,
        mass=mass,
        inertia=_thick(links.inertia),
        body_mass=plan.robot.mass - float(mass.sum()),
        body_inertia=_thick(links.body_inertia),
    )


def _thick(inertia: Array) -> Array:
    """Inertias whose principal moments are no less than MuJoCo integrates well."""
    value, vector = np.linalg.eigh((inertia + np.swapaxes(inertia, -1, -2)) / 2)
    value = np.maximum(value, _LEAST_INERTIA)
    return np.asarray((vector * value[..., None, :]) @ np.swapaxes(vector, -1, -2))
