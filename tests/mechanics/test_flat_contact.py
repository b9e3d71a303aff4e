"""Corner forces in their cones: centre of pressure inside, moment that of all of them."""

from __future__ import annotations

import numpy as np

from climbplan.mechanics.flat_contact import (
    beyond_sole,
    centre_of_pressure,
    moment_of,
    spread_to_corners,
)
from climbplan.robots.foot import Sole

SOLE = Sole(0.2, 0.1, np.eye(3)[None], heading=0.4)
MU = 0.6


def test_corner_forces_have_their_centre_of_pressure_inside() -> None:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(500, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    axes = SOLE.axes(normal)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_allclose(axes[..., 2], normal, atol=1e-12)
    press = rng.uniform(0, 100, (500, 4))
    angle, share = rng.uniform(0, 2 * np.pi, (500, 4)), rng.uniform(0, MU, (500, 4))
    local = np.stack([share * press * np.cos(angle), share * press * np.sin(angle), press], -1)
    force = np.einsum("fij,fcj->fci", axes, local)
    moment = moment_of(SOLE, normal, force)
    centre = centre_of_pressure(SOLE, normal, force.sum(axis=1), moment)
    assert (beyond_sole(SOLE, centre) <= 1e-12).all()
    # It is where pressure alone has no moment along and across
    weighted = (press[..., None] * SOLE.corners).sum(axis=1) / press.sum(axis=1)[:, None]
    np.testing.assert_allclose(centre, weighted, atol=1e-12)
    # and the moment about the normal is that of the shear alone
    x, y = np.moveaxis(SOLE.corners, -1, 0)
    shear = (x * local[..., 1] - y * local[..., 0]).sum(axis=1)
    np.testing.assert_allclose(np.einsum("fi,fi->f", moment, normal), shear, atol=1e-10)


def test_level_soles_point_where_the_heading_does() -> None:
    axes = SOLE.axes(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(axes[:, 1], [-np.sin(0.4), np.cos(0.4), 0.0])
    # On a wall ahead toes point up, on one to the right they point on
    straight = Sole(0.2, 0.1, np.eye(3)[None])
    np.testing.assert_allclose(straight.axes(np.array([0.0, -1.0, 0.0]))[:, 1], [0, 0, 1], atol=0)
    np.testing.assert_allclose(straight.axes(np.array([-1.0, 0.0, 0.0]))[:, 1], [0, 1, 0], atol=0)


def test_forces_inside_a_sole_are_spread_to_its_corners() -> None:
    rng = np.random.default_rng(1)
    margin, normal = 0.3, np.array([0.0, 0.0, 1.0])
    inside = rng.normal(size=(20, 4, 3))
    force = spread_to_corners(inside, margin)
    np.testing.assert_allclose(force.sum(axis=1), inside.sum(axis=1), atol=1e-12)
    np.testing.assert_allclose(
        moment_of(SOLE, normal, force), moment_of(SOLE.within(margin), normal, inside), atol=1e-12
    )
