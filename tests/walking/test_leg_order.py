"""The order of legs: gaits, mirrors and contrasts of four, six and eight of them."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.robots.leg_order import alternating, contrasts, mirror_legs
from climbplan.walking.offline.gait_moves import list_contact_moves
from climbplan.walking.offline.gaits import GAITS, build_gait_phases

COUNTS = (4, 6, 8)


def test_gaits_of_a_quadruped() -> None:
    """Left front, right front, left hind, right hind."""
    assert build_gait_phases("trot", 4).astype(int).tolist() == [[1, 0, 0, 1], [0, 1, 1, 0]]
    assert build_gait_phases("pace", 4).astype(int).tolist() == [[1, 0, 1, 0], [0, 1, 0, 1]]
    assert build_gait_phases("bound", 4).astype(int).tolist() == [[1, 1, 0, 0], [0, 0, 1, 1]]
    swings = [int(np.flatnonzero(~row)[0]) for row in build_gait_phases("walk", 4)]
    assert swings == [0, 3, 1, 2]


def test_a_hexapod_trots_on_tripods() -> None:
    """Both end legs of a side, and the middle one of the other."""
    assert build_gait_phases("trot", 6).astype(int).tolist() == [
        [1, 0, 0, 1, 1, 0],
        [0, 1, 1, 0, 0, 1],
    ]


@pytest.mark.parametrize("legs", COUNTS)
@pytest.mark.parametrize("name", GAITS)
def test_every_leg_takes_part(name: str, legs: int) -> None:
    steps = build_gait_phases(name, legs)
    assert steps.shape[1] == legs
    stands = steps.mean(axis=0)
    np.testing.assert_array_equal(stands, stands[0])  # all for the same share of the time


@pytest.mark.parametrize("legs", COUNTS)
def test_mirrors(legs: int) -> None:
    other = mirror_legs(legs)
    np.testing.assert_array_equal(other[other], np.arange(legs))
    np.testing.assert_array_equal(alternating(legs)[other], 1 - alternating(legs))


@pytest.mark.parametrize("legs", COUNTS)
def test_contrasts_are_what_differences_are(legs: int) -> None:
    force = np.random.default_rng(legs).normal(size=legs)
    pairs = ((force[:, None] - force[None]) ** 2).sum()
    rows = contrasts(legs)
    np.testing.assert_allclose(rows @ rows.T, np.eye(legs - 1), atol=1e-12)
    np.testing.assert_allclose(2 * legs * ((rows @ force) ** 2).sum(), pairs)


@pytest.mark.parametrize("legs", COUNTS)
def test_moves_of_a_search_are_of_all_legs(legs: int) -> None:
    contact = np.ones((3, legs), bool)
    moves = list_contact_moves(contact)
    assert all(move.shape == contact.shape for move in moves)
    flipped = {tuple(np.flatnonzero(~move[1])) for move in moves}
    assert {(leg,) for leg in range(legs)} <= flipped
