"""Separation and distance of rectangles against clipping and brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bookshelf_oracle import polygon_distance

from climbplan.bookshelf.scene.rectangles import (
    compute_corners,
    compute_distance,
    compute_half_extents,
    compute_separation,
)


def _random(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    pose = np.stack(
        [rng.uniform(-40, 40, count), rng.uniform(-40, 40, count), rng.uniform(-4, 4, count)], 1
    )
    return pose, rng.uniform(5, 60, (count, 2))


def test_corners_are_numbered_from_the_top_right_clockwise() -> None:
    corner = compute_corners(np.array([1.0, 2.0, 0.0]), np.array([6.0, 4.0]))
    np.testing.assert_allclose(corner, [[3, 5], [3, -1], [-1, -1], [-1, 5]])
    # A tilt to the left lowers the bottom left corner and moves the top to the left.
    tilted = compute_corners(np.array([0.0, 0.0, 0.3]), np.array([6.0, 4.0]))
    assert tilted[:, 1].argmin() == 2
    assert tilted[3, 0] < -2


def test_half_extents_bound_the_corners_tightly() -> None:
    pose, size = _random(np.random.default_rng(0), 200)
    corner = compute_corners(pose, size) - pose[:, None, :2]
    np.testing.assert_allclose(
        compute_half_extents(pose[:, 2], size), corner.max(axis=1), atol=1e-12
    )


def _clipped(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Corners of the intersection of two convex polygons (Sutherland and Hodgman)."""
    points = list(a)
    for k in range(4):
        start, edge = b[k], b[(k + 1) % 4] - b[k]
        inside = [edge[0] * (p - start)[1] - edge[1] * (p - start)[0] <= 0 for p in points]
        kept = []
        for i, p in enumerate(points):
            q, here, there = points[i - 1], inside[i], inside[i - 1]
            if here != there:
                normal = np.array([-edge[1], edge[0]])
                share = normal @ (start - q) / (normal @ (p - q))
                kept.append(q + share * (p - q))
            if here:
                kept.append(p)
        points = kept
    return np.array(points)


def test_separation_has_the_sign_of_the_intersection() -> None:
    rng = np.random.default_rng(1)
    pose_a, size_a = _random(rng, 400)
    pose_b, size_b = _random(rng, 400)
    gap = compute_separation(pose_a, size_a, pose_b, size_b)
    a, b = compute_corners(pose_a, size_a), compute_corners(pose_b, size_b)
    meets = np.array([len(_clipped(p, q)) > 2 for p, q in zip(a, b, strict=True)])
    assert 50 < meets.sum() < 350
    assert (meets == (gap < 0)).all()


def test_penetration_depth_is_the_least_way_out() -> None:
    rng = np.random.default_rng(2)
    angles = np.linspace(0, 2 * math.pi, 721)
    for _ in range(60):
        pose, size = _random(rng, 2)
        pose[1, :2] = pose[0, :2] + rng.uniform(-8, 8, 2)
        depth = -compute_separation(pose[0], size[0], pose[1], size[1])
        if depth <= 0:
            continue
        ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        moved = np.concatenate(
            [pose[1, :2] + 0.999 * depth * ways, np.full((721, 1), pose[1, 2])], 1
        )
        assert (
            compute_separation(pose[0], size[0], moved, size[1]) < 0
        ).all()  # too little, any way
        parted = pose[1, :2] + 1.001 * depth * _faces(pose)
        moved = np.concatenate([parted, np.full((8, 1), pose[1, 2])], axis=1)
        assert compute_separation(pose[0], size[0], moved, size[1]).max() > 0


def _faces(pose: np.ndarray) -> np.ndarray:
    """The eight face normals of two rectangles."""
    angles = np.concatenate([a + np.pi / 2 * np.arange(4) for a in pose[:, 2]])
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def test_distance_is_that_of_the_polygons() -> None:
    rng = np.random.default_rng(3)
    pose_a, size_a = _random(rng, 300)
    pose_b, size_b = _random(rng, 300)
    found = compute_distance(pose_a, size_a, pose_b, size_b)
    apart = compute_separation(pose_a, size_a, pose_b, size_b) > 0
    assert (found[~apart] == 0).all()
    a, b = compute_corners(pose_a, size_a), compute_corners(pose_b, size_b)
    for k in np.nonzero(apart)[0]:
        assert found[k] == pytest.approx(
            polygon_distance(a[k].tolist(), b[k].tolist(), 0.0), abs=1e-9
        )
