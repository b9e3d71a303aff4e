"""The safety factor S_mu by which a friction check judges, so that what it prints is what it let
pass.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.verification.check import LIMITS


def friction_factor(name: str, shear: Array, held: Array, weight: float) -> Array:
    """The largest S_mu at which the check `name` passes at each place, infinite if any does.

    shear, held: (...) tangential force and what friction holds of it [N]; weight: that the check's
    limit is relative to [N]. A check lets pass shear <= held / S_mu + slack, so that S_mu = held /
    (shear - slack): shear within the slack tells nothing of friction. NaN stays NaN.
    """
    beyond = shear - LIMITS[name].value * weight
    factor = np.where(np.isnan(beyond) | np.isnan(held), np.nan, np.inf)
    np.divide(np.maximum(held, 0.0), beyond, out=factor, where=beyond > 0)
    return factor


def least_factor(factor: Array) -> str:
    """The margin of a friction check: "S_mu 1.80"; places without a number are left out."""
    return f"S_mu {np.min(factor, initial=np.inf, where=~np.isnan(factor)):.2f}"
