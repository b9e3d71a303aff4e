"""Boxes that toes of a walking robot stay in: reachable everywhere, and everywhere strong enough.

All boxes have one size and are centred on the standing toes. They grow step by step as long as
every point of a grid in every box has inverse kinematics two degrees inside the joint bounds, and
the leg holds its part of the robot's weight there. That part is half of the weight, or, of four
legs, what it bears on a diagonal: more the nearer it stands to the centre of mass. A small margin
is then subtracted, and a finer grid and random points are tested. Planning and checks use exact
kinematics in any case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_STEP = 0.01  # [m] by which boxes grow
_SHAPE = (1.0, 0.7, 0.6)  # proportions in which the extents x, y, z grow
_MAX_SIZE = 0.6  # of half extents, over the farthest standing toe from its first joint
_MARGIN = 0.005  # [m] subtracted from what the grid allows
_GAP = 0.02  # [m] between boxes of neighbours
_MIN_HALF = (0.03, 0.02, 0.02)  # [m] half extents with which a step is possible
_BOUND_MARGIN = np.deg2rad(2.0)  # of joints from their bounds, in their units
# Part of the weight that a leg holds anywhere in its box: the middle one of a tripod is alone on
# its side
_SHARE = 0.5
_MIN_SHARE = 0.1  # that any leg has to hold
_COARSE, _FINE = 3, 5  # points along each edge, while boxes grow and at the end
_NUM_SAMPLES = 500  # random points of each box


@dataclass(frozen=True)
class ToeBoxes:
    """Boxes of one size for all legs."""

    center: Array  # (L, 3) standing toes, body frame [m]
    half: Array  # (3,) [m]
    force: float  # largest vertical force that a leg holds everywhere in its box [N]


def grow_toe_boxes(
    chain: SerialChain, toes: Array, lower: Array, upper: Array, torque: Array, weight: float
) -> ToeBoxes | str:
    """Grow boxes about the toes of L legs with J joints each.

    Args:
        chain: The legs, front ones first.
        toes: Standing toes (L, 3) from the centre of mass [m].
        lower: Lower joint bounds (L, J) [rad].
        upper: Upper joint bounds (L, J) [rad].
        torque: Torque limits (L, J) [N m].
        weight: Of the robot [N].

    Returns:
        The boxes, or why there are none.
    """
    test = _BoxTest(chain, toes, lower, upper, torque, compute_weight_fractions(toes) * weight)
    pairs, lateral = toes[:, 0].reshape(-1, 2), toes[:, 1]
    spacing = (pairs[:-1].min(axis=1) - pairs[1:].max(axis=1)).min()
    max_half = np.array([spacing, lateral[::2].min() - lateral[1::2].max(), np.inf])
    length = np.linalg.norm(toes - chain.joint_zero[:, 0], axis=1).max()
    max_half = np.minimum(max_half / 2 - _GAP / 2, _MAX_SIZE * length)
    half = np.zeros(3)
    if not test.is_strong_enough(half):
        force = test.compute_force(np.zeros((1, 3)))
        limb = int(np.argmin(force / test.required))
        return (
            "standing, a leg cannot hold its part of the weight within its torque limits "
            f"({force[limb]:.0f} of {test.required[limb]:.0f} N), or a joint is within 2 degrees "
            "of a bound"
        )
    shape = np.array(_SHAPE)
    while test.is_strong_enough(next_half := np.minimum(half + _STEP * shape, max_half)):
        if (next_half == half).all():
            break
        half = next_half
    for axis in (0, 2, 1):
        larger = half.copy()
        while larger[axis] < max_half[axis]:
            larger[axis] = min(larger[axis] + _STEP, max_half[axis])
            if not test.is_strong_enough(larger):
                break
            half = larger.copy()
    samples = np.random.default_rng(0).uniform(-1, 1, (_NUM_SAMPLES, 3))
    half = half - _MARGIN
    while (half > _MIN_HALF).all():
        force = test.compute_force(samples * half)
        if (force >= test.required).all():
            force = np.minimum(force, test.compute_force(_grid(_FINE) * half))
            if (force >= test.required).all():
                return ToeBoxes(toes, half, float(force.max()))
        half = half - _MARGIN
    size = ", ".join(f"{1e3 * max(h, 0.0):.0f}" for h in half)
    return (
        "toes have no room to walk within their joints' bounds and torque limits: half extents of "
        f"{size} mm along, across and up about the standing toes, expected more than 30, 20, 20"
    )


class _BoxTest:
    """A test of reachability and strength at points of boxes about the toes of L legs."""

    def __init__(
        self,
        chain: SerialChain,
        toes: Array,
        lower: Array,
        upper: Array,
        torque: Array,
        required: Array,
    ) -> None:
        self.chain, self.toes, self.torque, self.required = chain, toes, torque, required
        margin = _BOUND_MARGIN * chain.zero.unit
        self.lower, self.upper = lower + margin, upper - margin

    def is_strong_enough(self, half: Array) -> bool:
        """Return whether boxes of this size are reached and strong enough on the coarse grid."""
        return bool((self.compute_force(_grid(_COARSE) * half) >= self.required).all())

    def compute_force(self, offsets: Array) -> Array:
        """Return the vertical forces (L,) that legs hold with toes off by (P, 3) [m], in newtons.

        The smallest over the offsets; zero if one is out of reach.
        """
        points = self.toes + offsets[:, None]  # (P, L, 3)
        solution = self.chain.inverse(points, self.lower, self.upper)
        if not solution.valid.all():
            return np.zeros(len(self.toes))
        lever = np.abs(self.chain.jacobian(solution.best())[..., 2, :])  # (P, L, 3) by joint
        return np.asarray((self.torque / np.maximum(lever, 1e-9)).min(axis=(0, 2)))


def compute_weight_fractions(toes: Array) -> Array:
    """Return the part of the weight (L,) that each leg bears.

    toes: (L, 3) from the centre of mass, front ones first [m].
    """
    if len(toes) != 4:
        return np.full(len(toes), _SHARE)
    front, rear = toes[:2, 0].mean(), -toes[2:, 0].mean()
    fraction = np.clip(rear / max(front + rear, 1e-9), _MIN_SHARE, 1 - _MIN_SHARE)
    return np.repeat([fraction, 1 - fraction], 2)


def _grid(count: int) -> Array:
    """Return the points of a grid over the cube of half extent 1, (P, 3)."""
    edge = np.linspace(-1, 1, count)
    return np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
