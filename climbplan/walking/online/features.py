"""Features of a measurement for candidate ranking, scaled to comparable distances."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.leg_order import MIRROR_POINT, MIRROR_TURN, mirror_legs
from climbplan.walking.online.tick_input import TickInput

# Difference that counts as a unit of distance, for each kind of feature
_SCALES = {
    "velocity": 0.4,
    "asked": 0.4,
    "height": 0.05,
    "tilt": 0.15,
    "spin": 1.0,
    "toes": 0.08,
    "toes_before": 0.16,
    "contact": 1.0,
}


def compute_features(measurement: TickInput, height: float, reference_velocity: Array) -> Array:
    """Return the features (F,) of a measurement.

    Args:
        measurement: state, toes and recent contacts.
        height: reference height of the body [m].
        reference_velocity: (3,) world frame [m/s].
    """
    position = measurement.position
    blocks = (
        measurement.velocity / _SCALES["velocity"],
        reference_velocity / _SCALES["asked"],
        (position[2:3] - height) / _SCALES["height"],
        measurement.tilt / _SCALES["tilt"],
        measurement.angular_velocity / _SCALES["spin"],
        (measurement.toes[:, :2] - position[:2]).ravel() / _SCALES["toes"],
        (measurement.previous_toes[:, :2] - position[:2]).ravel() / _SCALES["toes_before"],
        measurement.previous_contact.astype(float) / _SCALES["contact"],
    )
    return np.concatenate(blocks)


def feature_count(legs: int) -> int:
    """Return the number F of features."""
    return 12 + 5 * legs


def build_mirror_matrix(legs: int) -> Array:
    """Return the matrix (F, F) that maps features to those of the mirrored measurement."""
    mirror_xy = np.diag([1.0, -1.0])
    leg_permutation = np.eye(legs)[mirror_legs(legs)]
    blocks = [
        np.diag(MIRROR_POINT),
        np.diag(MIRROR_POINT),
        np.eye(1),
        np.diag(MIRROR_TURN[:2]),
        np.diag(MIRROR_TURN),
        np.kron(leg_permutation, mirror_xy),
        np.kron(leg_permutation, mirror_xy),
        leg_permutation,
    ]
    size = sum(len(block) for block in blocks)
    mirror, offset = np.zeros((size, size)), 0
    for block in blocks:
        mirror[offset : offset + len(block), offset : offset + len(block)] = block
        offset += len(block)
    return mirror
