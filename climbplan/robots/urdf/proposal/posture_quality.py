"""Quality of leg postures: the margin about each toe and the torque that forces take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_MAX_JOINT_CHANGE = 0.5  # [rad] to which the first order is trusted
_SINGULAR_RATIO = 1e-3  # of the largest singular value: directions in which a toe can hardly move


@dataclass(frozen=True)
class PostureQuality:
    """The quality of F postures of N legs."""

    # (F, N) radius of the ball about the toe that joints reach within bounds, first order [m]
    reach_margin: Array
    utilisation: Array  # (F, N) largest fraction of a torque limit
    points: Array  # (F, N, P, 3) joints and toe, body frame [m]

    @property
    def score(self) -> Array:
        """The reach margin times the unused torque fraction, (F, N) [m]; at most 0 if too weak."""
        return self.reach_margin * np.minimum(1.0 - self.utilisation, 1.0)


def evaluate_postures(
    chain: SerialChain, angles: Array, force: Array, limits: tuple[Array, Array, Array]
) -> PostureQuality:
    """Evaluate postures under forces on the toes.

    Args:
        chain: N legs of J joints.
        angles: (F, N, J) [rad].
        force: (..., N, 3) on the toes [N].
        limits: Lower and upper bounds [rad] and torque limits [N m], each (N, J).
    """
    lower, upper, torque = limits
    jacobian = chain.jacobian(angles)  # (F, N, 3, J)
    inverse = np.linalg.pinv(jacobian, rcond=_SINGULAR_RATIO)
    rate = np.linalg.norm(inverse, axis=-1)  # (F, N, J) joint turned by a metre of toe
    bound_margin = np.minimum(angles - lower, upper - angles)
    exists = np.abs(chain.axis_zero).max(axis=-1) > 0  # (N, J)
    reach_margin = np.where(exists & (rate > 0), bound_margin / np.maximum(rate, 1e-9), np.inf).min(
        axis=-1
    )
    smallest = np.linalg.svd(jacobian, compute_uv=False)[..., -1]
    # Near full stretch the first order overestimates the margin
    reach_margin = np.minimum(reach_margin, _MAX_JOINT_CHANGE * smallest)
    torques = np.einsum("fnij,...ni->fnj", jacobian, np.asarray(force, float))
    utilisation = np.where(exists, np.abs(torques) / torque, 0.0).max(axis=-1)
    return PostureQuality(reach_margin, utilisation, chain.joint_points(angles))
