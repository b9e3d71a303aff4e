"""Joint bounds that differ between the left and the right leg of a pair.

The mirror image of a rotation about an axis (x, y, z), with x to the right, is one by the same
angle about (x, -y, -z). Bounds of the other leg are therefore the same where its axis is that one,
and negated and swapped where its axis is the opposite.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.postures import LegModel

_MAX_DIFFERENCE = np.deg2rad(3.0)  # [rad] between a bound and the mirror image of the other one
_MIN_ALIGNMENT = 0.95  # cosine between an axis and the mirror image of the other one
_MAX_LISTED = 3  # joints that are named


def describe_unmirrored_bounds(legs: LegModel) -> list[str]:
    """Return a note on joints whose bounds are no mirror image of the other leg's; none if all are.

    Args:
        legs: Pairs of legs with the bounds of the URDF, or bounds as far inside of these.
    """
    lower, upper = (np.clip(bound, -np.pi, np.pi) for bound in (legs.lower, legs.upper))
    axes = legs.chain.axis_zero
    pairs = []
    for leg, twin in enumerate(legs.mirrored_legs):
        if twin is None or twin <= leg:
            continue
        for joint, (name, twin_name) in enumerate(
            zip(legs.chain.names[leg], legs.chain.names[twin], strict=True)
        ):
            alignment = float((axes[leg, joint] * [1.0, -1.0, -1.0]) @ axes[twin, joint])
            if not name or not twin_name or abs(alignment) < _MIN_ALIGNMENT:
                continue
            expected = np.array([lower[leg, joint], upper[leg, joint]])
            if alignment < 0:
                expected = -expected[::-1]
            bounds = np.array([lower[twin, joint], upper[twin, joint]])
            if np.abs(bounds - expected).max() > _MAX_DIFFERENCE:
                actual, mirrored = (_format_bounds(values) for values in (bounds, expected))
                pairs.append(
                    f"{twin_name} turns by {actual}, as the mirror image of {name} {mirrored}"
                )
    if not pairs:
        return []
    more = f" and {len(pairs) - _MAX_LISTED} more" if len(pairs) > _MAX_LISTED else ""
    listed = "; ".join(pairs[:_MAX_LISTED])
    return [f"joint bounds are not mirrored between left and right [deg]: {listed}{more}"]


def _format_bounds(bounds: Array) -> str:
    """Return bounds (2,) [rad] in degrees."""
    low, high = np.rad2deg(bounds)
    return f"{low:.0f} to {high:.0f}"
