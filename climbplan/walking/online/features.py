"""Numbers by which situations are near or far: what learned strategies are given."""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.leg_order import MIRROR_POINT, MIRROR_TURN, mirror_legs
from climbplan.walking.online.measurement import Situation
from climbplan.walking.task.task import SPIN, VELOCITY

# What a unit of distance between two situations is, for each kind of feature
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


def features_of(situation: Situation, height: float, asked: Array) -> Array:
    """(F,) features; height: reference of the body [m]; asked: (3,) its velocity [m/s]."""
    state = situation.state
    parts = (
        state[VELOCITY] / _SCALES["velocity"],
        asked / _SCALES["asked"],
        (state[2:3] - height) / _SCALES["height"],
        state[6:8] / _SCALES["tilt"],
        state[SPIN] / _SCALES["spin"],
        (situation.toes[:, :2] - state[:2]).ravel() / _SCALES["toes"],
        (situation.toes_before[:, :2] - state[:2]).ravel() / _SCALES["toes_before"],
        situation.contact_before.astype(float) / _SCALES["contact"],
    )
    return np.concatenate(parts)


def feature_count(legs: int) -> int:
    """F."""
    return 12 + 5 * legs


def feature_mirror(legs: int) -> Array:
    """Features of the mirrored situation as a matrix (F, F)."""
    flat = np.diag([1.0, -1.0])
    swap = np.eye(legs)[mirror_legs(legs)]
    blocks = [
        np.diag(MIRROR_POINT),
        np.diag(MIRROR_POINT),
        np.eye(1),
        np.diag(MIRROR_TURN[:2]),
        np.diag(MIRROR_TURN),
        np.kron(swap, flat),
        np.kron(swap, flat),
        swap,
    ]
    size = sum(len(block) for block in blocks)
    whole, at = np.zeros((size, size)), 0
    for block in blocks:
        whole[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return whole
