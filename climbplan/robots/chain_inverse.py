"""Inverse kinematics of chains with any number of joints: the posture nearest to a given one.

    minimise    |q - q0|^2     over joint angles q
    subject to  p(q) = x       (the toe is at its place)
                l <= q <= u    (joint bounds)

with the limb's own posture q0 and lengths of prismatic joints counted in units of `RADIAN`
(0.25 m). Damped Gauss-Newton steps go from q0 along the straight line to x. Their null-space motion
reduces |q - q0|, and joints that would leave their bounds are fixed there. The answer depends on x
alone, so that a toe that comes back has the same angles, and angles are continuous where the toe's
path is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.robots.chain_pose import ChainZero


@dataclass(frozen=True)
class ChainAngles:
    """Solutions for F toes."""

    angles: Array  # (F, J) within the bounds [rad, or m of joints that slide]
    reached: BoolArray  # (F,)
    missing: Array  # (F,) distance left [m]


def chain_inverse(
    chain: ChainZero,
    posture: Array,
    limbs: IntArray,
    toes: Array,
    lower: Array,
    upper: Array,
) -> ChainAngles:
    """Solve the inverse kinematics of F toes.

    Args:
        chain: N limbs of J joints at zero angles.
        posture: Angles (N, J) to stay nearest to [rad, m].
        limbs: The limb of each toe (F,).
        toes: Positions (F, 3), body frame [m].
        lower: Lower bounds (F, J) [rad, m].
        upper: Upper bounds (F, J) [rad, m].
    """
    # Loads Numba, which robots with three joints a leg do without
    from climbplan.robots.chain_kernel import REACHED, ChainTable, solve_toes

    unit = chain.unit
    geometry = chain.in_radians()
    units = unit[limbs]
    lower_angle, upper_angle = lower / units, upper / units
    count = geometry.axes.shape[1]
    drive = geometry.drive
    drive = np.tile(np.eye(count), (len(posture), 1, 1)) if drive is None else drive
    chains = ChainTable(
        joints=np.ascontiguousarray(geometry.joints),
        axes=np.ascontiguousarray(geometry.axes),
        toe=np.ascontiguousarray(geometry.toe),
        slides=np.ascontiguousarray(
            np.zeros_like(geometry.axes) if geometry.slides is None else geometry.slides
        ),
        drive=np.ascontiguousarray(drive),
        moves=np.ascontiguousarray(geometry.moves),
        posture=np.ascontiguousarray(posture / unit),
    )
    angles, missing = solve_toes(
        chains,
        limbs,
        np.ascontiguousarray(toes),
        np.ascontiguousarray(lower_angle),
        np.ascontiguousarray(upper_angle),
        _are_out_of_reach(geometry.rows(limbs), toes, lower_angle, upper_angle, REACHED),
    )
    if chain.slides is not None:
        angles = np.clip(angles * units, lower, upper)
    return ChainAngles(angles, missing <= REACHED, missing)


def _are_out_of_reach(
    geometry: ChainZero, toes: Array, lower: Array, upper: Array, tolerance: float
) -> BoolArray:
    """Return the toes (F,) farther from the first joint than all links and slides in one line."""
    ends = np.concatenate([geometry.joints, geometry.toe[:, None]], axis=1)
    length = np.linalg.norm(np.diff(ends, axis=1), axis=-1).sum(axis=-1)
    if geometry.slides is not None:
        max_extension = np.maximum(np.abs(lower), np.abs(upper))
        if geometry.drive is not None:
            max_extension = (np.abs(geometry.drive) @ max_extension[..., None])[..., 0]
        length = length + (np.linalg.norm(geometry.slides, axis=-1) * max_extension).sum(axis=-1)
    return np.asarray(np.linalg.norm(toes - geometry.joints[:, 0], axis=1) > length + tolerance)
