"""Forces of single limbs: those that are nearly straight give way at the toe."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.robots.rotations import Array
from climbplan.simulation.statics.compiling import compiled
from climbplan.simulation.statics.limb import SOFTEST, _chain, _held, _softness, _volume
from climbplan.simulation.statics.tuples import Pad, Springs

STIFF, COMMAND = 50.0, np.array([0.1, 0.2, -0.1])  # [N m/rad], [rad]


@compiled
def chain(zero: Array, angles: Array, columns: Array, axes: Array, out: Array) -> None:
    """`_chain`."""
    _chain(zero, angles, columns, axes, out)


@compiled
def softness(zero: Array, angles: Array, pad: Pad) -> float:
    """`_softness`."""
    _chain(zero, angles, pad.m[0], pad.m[1], pad.v[0])
    return _softness(zero, _volume(pad.m[0]))


@compiled
def hold(
    zero: Array, place: Array, springs: Springs, angles: Array, force: Array, slope: Array, pad: Pad
) -> bool:
    """`_held` of the first limb."""
    return _held(zero, 0, place, springs, angles, force, slope, pad)


def limb() -> Array:
    """(7, 3) of one that lies stretched along x at zero angles."""
    axes = [[0, 0, 1], [0, -1, 0], [0, -1, 0]]
    return np.array([*axes, [0, 0, 0], [0.05, 0, 0], [0.25, 0, 0], [0.5, 0, 0]], float)


def pad() -> Pad:
    return Pad(np.zeros((12, 3)), np.zeros((8, 3, 3)), np.zeros(6), np.zeros((6, 6)), np.zeros(6))


def held(place: Array, soft: float, start: Array) -> tuple[Array, Array]:
    """Force and slope of a toe at a place."""
    springs = Springs(
        command=COMMAND[None].copy(), weight=np.zeros((1, 3)), stiffness=np.full((1, 3), STIFF),
        half=np.zeros((1, 3)), loose=np.full((1, 3), STIFF), volume=np.zeros(1),
        soft=np.array([soft]),
    )  # fmt: skip
    force, slope, angles = np.zeros(3), np.zeros((3, 3)), start.copy()
    assert hold(limb(), place, springs, angles, force, slope, pad())
    return force, slope


def toe(angles: Array) -> Array:
    out = np.zeros(3)
    chain(limb(), angles, np.zeros((3, 3)), np.zeros((3, 3)), out)
    return out


def test_only_limbs_that_are_nearly_straight_give_way() -> None:
    bent, straight = np.array([0.0, 0.6, -1.2]), np.array([0.0, 0.3, 0.0])
    assert softness(limb(), bent, pad()) == 0.0
    assert softness(limb(), straight, pad()) == pytest.approx(SOFTEST)


@pytest.mark.parametrize("knee", [-1.2, -0.6])
def test_a_toe_that_hardly_gives_way_is_held_as_one_that_does_not(knee: float) -> None:
    angles = np.array([0.05, 0.3, knee])
    rigid, firm = held(toe(angles), 0.0, angles)
    given, soft = held(toe(angles), 1e-8, angles)
    np.testing.assert_allclose(given, rigid, rtol=1e-3, atol=1e-2)
    np.testing.assert_allclose(soft, firm, rtol=1e-3, atol=1e-2 * np.abs(firm).max())


@pytest.mark.parametrize("knee", [-0.2, -0.02, 0.0])
def test_a_straight_limb_has_a_force_that_changes_steadily(knee: float) -> None:
    place = toe(np.array([0.08, 0.22, knee])) + np.array([1e-4, 0.0, 2e-4])
    start = np.array([0.08, 0.22, knee])
    force, slope = held(place, SOFTEST, start)
    step = 1e-7
    for a in range(3):
        moved = place + step * np.eye(3)[a]
        change = (held(moved, SOFTEST, start)[0] - force) / step
        np.testing.assert_allclose(change, slope[:, a], rtol=2e-2, atol=2e-3 / SOFTEST)
    assert np.linalg.eigvalsh((slope + slope.T) / 2).max() <= 1.0001 / SOFTEST
