"""Distances of links against sampled ones."""

from __future__ import annotations

import numpy as np

from climbplan.limms.modules.distances import block_gap, segment_to_block, segment_to_segment

RNG = np.random.default_rng(3)


def test_segment_to_block_is_the_least_sampled_distance() -> None:
    first, last = RNG.uniform(-2, 2, (2, 60, 3))
    low = RNG.uniform(-1, 0, (60, 3))
    high = low + RNG.uniform(0.1, 1, (60, 3))
    found = segment_to_block(first, last, low, high)
    share = np.linspace(0, 1, 4001)[:, None, None]
    points = first + share * (last - first)
    out = np.maximum(np.maximum(low - points, points - high), 0)
    sampled = np.linalg.norm(out, axis=-1).min(axis=0)
    assert (found <= sampled + 1e-6).all()
    assert np.abs(found - sampled).max() < 2e-3


def test_segments_along_faces_and_points_are_exact() -> None:
    low, high = np.zeros(3), np.ones(3)
    cases = [  # two ends, distance
        ((2.0, 0.5, 0.5), (2.0, 0.5, 0.5), 1.0),  # a point
        ((-1.0, 1.5, 0.5), (2.0, 1.5, 0.5), 0.5),  # along a face
        ((0.5, 0.5, -1.0), (0.5, 0.5, 2.0), 0.0),  # through
        ((1.0, -1.0, 2.0), (1.0, 2.0, 2.0), 1.0),  # over an edge
        ((2.0, 0.0, 0.5), (0.0, 2.0, 0.5), 0.0),  # touches an edge in its middle
        ((3.0, 0.0, 0.5), (0.0, 3.0, 0.5), np.sqrt(0.5)),
    ]
    first, last, wanted = (np.array([case[k] for case in cases]) for k in range(3))
    assert np.allclose(segment_to_block(first, last, low, high), wanted, atol=1e-12)
    # As many at a time as there are
    many = RNG.uniform(-2, 2, (2, 3000, 4, 1, 3))
    blocks = np.stack([low, low - 2, low + 1.5]), np.stack([high, high - 2, high + 1.5])
    found = segment_to_block(*many, *blocks)
    assert np.array_equal(found[1234], segment_to_block(*many[:, 1234], *blocks))


def test_segment_to_segment_is_the_least_sampled_distance() -> None:
    a0, a1, b0, b1 = RNG.uniform(-1, 1, (4, 60, 3))
    found = segment_to_segment(a0, a1, b0, b1)
    s = np.linspace(0, 1, 201)
    one = a0[:, None] + s[:, None] * (a1 - a0)[:, None]
    other = b0[:, None] + s[:, None] * (b1 - b0)[:, None]
    apart = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1).min(axis=(1, 2))
    assert (found <= apart + 1e-9).all()
    assert np.abs(found - apart).max() < 0.02


def test_block_gap_is_signed() -> None:
    half = np.full(3, 0.5)
    low, high = np.zeros(3), np.ones(3)
    assert block_gap(np.array([2.0, 0.5, 0.5]), half, low, high) == 0.5
    assert block_gap(np.array([1.4, 0.5, 0.5]), half, low, high) < 0
