"""The safety factor S_mu at which a friction check passes, for its printed margin."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.verification.check import LIMITS


def compute_friction_factor(name: str, shear: Array, max_shear: Array, weight: float) -> Array:
    """Return the largest S_mu (...) with which the check `name` passes; infinite if all do.

    A check accepts shear <= max_shear / S_mu + slack, so that S_mu = max_shear / (shear - slack).
    Shear within the slack gives no factor. NaN stays NaN.

    Args:
        name: Name of the check.
        shear: (...) tangential force [N].
        max_shear: (...) tangential force that friction holds [N].
        weight: Weight that the check's limit is relative to [N].
    """
    excess = shear - LIMITS[name].value * weight
    factor = np.where(np.isnan(excess) | np.isnan(max_shear), np.nan, np.inf)
    np.divide(np.maximum(max_shear, 0.0), excess, out=factor, where=excess > 0)
    return factor


def format_min_factor(factor: Array) -> str:
    """Format the margin of a friction check: "S_mu 1.80"; NaN entries are left out."""
    return f"S_mu {np.min(factor, initial=np.inf, where=~np.isnan(factor)):.2f}"
