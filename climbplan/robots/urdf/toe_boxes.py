"""Boxes that toes of a walking robot keep within: reached everywhere, and everywhere strong enough.

All boxes have one size and stand about the standing toes. They grow step by step as long as
every point of a grid in every box has inverse kinematics two degrees inside the joint bounds, and
the leg holds its part of the robot's weight upright there: half of it, or, of four legs, what it
bears on a diagonal, more the nearer it stands to the centre of mass. A little is then taken off
again, and a finer grid and random points asked; planning and checks use exact kinematics anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_STEP = 0.01  # [m] by which boxes grow
_SHAPE = (1.0, 0.7, 0.6)  # extents along, across and up in which they grow together
_LARGEST = 0.6  # of the farthest standing toe from its first joint: half extents at most
_OFF = 0.005  # [m] taken off what the grid allows
_GAP = 0.02  # [m] between boxes of neighbours
_LEAST = (0.03, 0.02, 0.02)  # [m] half extents with which a step is possible
_BOUND = np.deg2rad(2.0)  # of joints from their bounds, in their units
# Of the weight, that a leg holds upright anywhere in its box: the middle one of a tripod, alone on
# its side
_SHARE = 0.5
_LEAST_SHARE = 0.1  # that any leg has to hold
_COARSE, _FINE = 3, 5  # points along each edge, while boxes grow and in the end
_DRAWN = 500  # random points of each box


@dataclass(frozen=True)
class ToeBoxes:
    """One size for all legs."""

    center: Array  # (L, 3) standing toes, body frame [m]
    half: Array  # (3,) [m]
    force: float  # largest upright force that a leg holds everywhere in its box [N]


def toe_boxes(
    chain: SerialChain, toes: Array, lower: Array, upper: Array, torque: Array, weight: float
) -> ToeBoxes | str:
    """Boxes about toes (L, 3) of legs with bounds and torque limits (L, 3), or why there are none.

    weight: of the robot [N].
    """
    found = _Grown(chain, toes, lower, upper, torque, borne(toes) * weight)
    pairs, across = toes[:, 0].reshape(-1, 2), toes[:, 1]
    along = (pairs[:-1].min(axis=1) - pairs[1:].max(axis=1)).min()
    most = np.array([along, across[::2].min() - across[1::2].max(), np.inf])
    leg = np.linalg.norm(toes - chain.joint_zero[:, 0], axis=1).max()
    most = np.minimum(most / 2 - _GAP / 2, _LARGEST * leg)
    half = np.zeros(3)
    if not found.holds(half):
        strong = found.force(np.zeros((1, 3)))
        leg = int(np.argmin(strong / found.least))
        return (
            "standing, a leg cannot hold its part of the weight within its torque limits "
            f"({strong[leg]:.0f} of {found.least[leg]:.0f} N), or a joint is within 2 degrees of a "
            "bound"
        )
    shape = np.array(_SHAPE)
    while found.holds(next_half := np.minimum(half + _STEP * shape, most)):
        if (next_half == half).all():
            break
        half = next_half
    for axis in (0, 2, 1):
        more = half.copy()
        while more[axis] < most[axis]:
            more[axis] = min(more[axis] + _STEP, most[axis])
            if not found.holds(more):
                break
            half = more.copy()
    drawn = np.random.default_rng(0).uniform(-1, 1, (_DRAWN, 3))
    half = half - _OFF
    while (half > _LEAST).all():
        force = found.force(drawn * half)
        if (force >= found.least).all():
            force = np.minimum(force, found.force(_grid(_FINE) * half))
            if (force >= found.least).all():
                return ToeBoxes(toes, half, float(force.max()))
        half = half - _OFF
    size = ", ".join(f"{1e3 * max(h, 0.0):.0f}" for h in half)
    return (
        "toes have no room to walk within their joints' bounds and torque limits: half extents of "
        f"{size} mm along, across and up about the standing toes, expected more than 30, 20, 20"
    )


class _Grown:
    def __init__(
        self,
        chain: SerialChain,
        toes: Array,
        lower: Array,
        upper: Array,
        torque: Array,
        least: Array,
    ) -> None:
        self.chain, self.toes, self.torque, self.least = chain, toes, torque, least
        kept = _BOUND * chain.zero.unit
        self.lower, self.upper = lower + kept, upper - kept

    def holds(self, half: Array) -> bool:
        """Whether boxes of this size are reached, and strong enough, at all points of the grid."""
        return bool((self.force(_grid(_COARSE) * half) >= self.least).all())

    def force(self, offsets: Array) -> Array:
        """(L,) least upright forces that legs hold, toes off by (P, 3); 0 where out of reach."""
        points = self.toes + offsets[:, None]  # (P, L, 3)
        solution = self.chain.inverse(points, self.lower, self.upper)
        if not solution.valid.all():
            return np.zeros(len(self.toes))
        upward = np.abs(self.chain.jacobian(solution.best())[..., 2, :])  # (P, L, 3) by joint
        return np.asarray((self.torque / np.maximum(upward, 1e-9)).min(axis=(0, 2)))


def borne(toes: Array) -> Array:
    """(L,) of the weight, that each leg bears; toes from the centre of mass, front ones first."""
    if len(toes) != 4:
        return np.full(len(toes), _SHARE)
    front, rear = toes[:2, 0].mean(), -toes[2:, 0].mean()
    share = np.clip(rear / max(front + rear, 1e-9), _LEAST_SHARE, 1 - _LEAST_SHARE)
    return np.repeat([share, 1 - share], 2)


def _grid(count: int) -> Array:
    edge = np.linspace(-1, 1, count)
    return np.stack(np.meshgrid(edge, edge, edge, indexing="ij"), axis=-1).reshape(-1, 3)
