"""Cones, inscribed pyramids and critical coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.mechanics.friction import (
    contact_frame,
    critical_friction,
    project_to_cone,
    pyramid_rows,
    regular_corners,
    split_force,
)


def _random_normals(count: int) -> np.ndarray:
    normal = np.random.default_rng(0).normal(size=(count, 3))
    level = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]])
    return np.concatenate([normal / np.linalg.norm(normal, axis=1, keepdims=True), level])


def test_frames_are_right_handed_and_upright() -> None:
    frame = contact_frame(_random_normals(50))
    axes = frame.axes
    product = axes @ np.swapaxes(axes, -1, -2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_allclose(frame.tangent[:50, 2], 0, atol=1e-12)
    assert (frame.bitangent[:50, 2] > 0).all()


@pytest.mark.parametrize("facets", [4, 5, 16])
def test_pyramid_is_inside_the_cone_and_touches_it(facets: int) -> None:
    rng = np.random.default_rng(facets)
    corners = np.sort(rng.uniform(0, 2 * np.pi, facets))
    if np.diff(np.append(corners, corners[0] + 2 * np.pi)).max() > np.pi:
        corners = regular_corners(facets)
    mu = np.array(0.7)
    rows = pyramid_rows(mu, corners)
    force = rng.normal(size=(4000, 3))
    force[:, 0] = np.abs(force[:, 0])
    inside = (force @ rows.T <= 0).all(axis=1)
    assert inside.sum() > 100
    shear = np.hypot(force[:, 1], force[:, 2])
    assert (shear[inside] <= mu * force[inside, 0] + 1e-12).all()
    edge = np.stack([np.ones(facets), mu * np.cos(corners), mu * np.sin(corners)], axis=1)
    np.testing.assert_allclose((edge @ rows.T).max(axis=1), 0, atol=1e-12)


def test_critical_friction_of_each_kind_of_force() -> None:
    normal = np.array([1.0, 0.0, 0.0])
    force = np.array(
        [[2.0, 1.0, 0.0], [0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0, 0]]
    )
    assert critical_friction(force, normal).tolist() == [0.5, 0.0, 0.0, np.inf, np.inf]


def test_projection_only_shortens_shear() -> None:
    rng = np.random.default_rng(1)
    normal = _random_normals(200)
    force = rng.normal(size=normal.shape)
    mu = rng.uniform(0.1, 1.0, len(normal))
    before, after = (
        split_force(force, normal),
        split_force(project_to_cone(force, normal, mu), normal),
    )
    pushing = before.normal > 0
    np.testing.assert_allclose(after.normal[pushing], before.normal[pushing])
    np.testing.assert_allclose(after.normal[~pushing], 0, atol=1e-12)
    assert (after.shear <= mu * np.maximum(after.normal, 0) + 1e-12).all()
    kept = pushing & (before.shear <= mu * before.normal)
    assert kept.any()
    np.testing.assert_allclose(after.tangential[kept], before.tangential[kept])
