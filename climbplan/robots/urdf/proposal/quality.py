"""How good a leg's angles are: room in its workspace, torque, and links that stay clear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_TURN = 0.5  # [rad] to which the first order is trusted
_FLAT = 1e-3  # of the largest singular value: directions in which a toe can hardly move


@dataclass(frozen=True)
class Quality:
    """Of F postures of N legs."""

    room: Array  # (F, N) ball about the toe that joints reach within their bounds, first order [m]
    use: Array  # (F, N) largest share of a torque limit
    points: Array  # (F, N, P, 3) joints and toe, body frame [m]

    @property
    def score(self) -> Array:
        """(F, N) room, less where motors have little left; never above zero where they have not."""
        return self.room * np.minimum(1.0 - self.use, 1.0)


def quality_of(
    chain: SerialChain, angles: Array, force: Array, limits: tuple[Array, Array, Array]
) -> Quality:
    """Of angles (F, N, J) under forces (..., N, 3) on the toes [N].

    limits: (N, J) lower and upper bounds [rad] and torques [N m].
    """
    lower, upper, torque = limits
    jacobian = chain.jacobian(angles)  # (F, N, 3, J)
    inverse = np.linalg.pinv(jacobian, rcond=_FLAT)
    size = np.linalg.norm(inverse, axis=-1)  # (F, N, J) joint turned by a metre of toe
    margin = np.minimum(angles - lower, upper - angles)
    there = np.abs(chain.axis_zero).max(axis=-1) > 0  # (N, J)
    room = np.where(there & (size > 0), margin / np.maximum(size, 1e-9), np.inf).min(axis=-1)
    least = np.linalg.svd(jacobian, compute_uv=False)[..., -1]
    # Near full stretch the first order promises room that is not there
    room = np.minimum(room, _TURN * least)
    taken = np.einsum("fnij,...ni->fnj", jacobian, np.asarray(force, float))
    use = np.where(there, np.abs(taken) / torque, 0.0).max(axis=-1)
    return Quality(room, use, chain.joint_points(angles))
