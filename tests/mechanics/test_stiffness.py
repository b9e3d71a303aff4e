"""Chapter 4: the equations against each other, against energy, and against exact kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.mechanics.equilibrium import wrench_of
from climbplan.mechanics.stiffness import (
    SingularPosture,
    body_deflection,
    contact_forces,
    deflections_for_forces,
    limb_compliance,
    limb_stiffness,
    rigid_motion,
    whole_body_stiffness,
)
from climbplan.robots.kinematics import jacobian_world, toe_world
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.robots.robot import RobotSpec


@dataclass(frozen=True)
class Posture:
    robot: Robot
    angles: Array
    rpy: Array
    arms: Array
    jacobian: Array


@pytest.fixture(params=range(3, 9), ids=lambda n: f"{n} limbs")
def posture(request: pytest.FixtureRequest, braced_robot: Callable[..., RobotSpec]) -> Posture:
    """Five random postures of a random robot."""
    n = request.param
    robot = Robot.from_spec(braced_robot(n, seed=n))
    rng = np.random.default_rng(n)
    angles = rng.uniform([-0.6, 0.2, -0.5], [0.6, 1.2, 0.6], (5, n, 3))
    rpy = rng.uniform(-0.3, 0.3, (5, 3))
    arms = toe_world(robot, np.zeros((5, 3)), rpy, angles)
    return Posture(robot, angles, rpy, arms, jacobian_world(robot, rpy, angles))


def test_limb_stiffness_is_symmetric_positive_definite(posture: Posture) -> None:
    stiffness = limb_stiffness(posture.robot, posture.jacobian)
    np.testing.assert_array_equal(stiffness, np.swapaxes(stiffness, -1, -2))
    assert np.linalg.eigvalsh(stiffness).min() > 0
    product = stiffness @ limb_compliance(posture.robot, posture.jacobian)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)


def test_the_structures_share_softens_a_limb_in_proportion(posture: Posture) -> None:
    rigid = replace(posture.robot, structural_compliance_share=0.0)
    soft = replace(posture.robot, structural_compliance_share=0.25)
    np.testing.assert_allclose(
        limb_stiffness(soft, posture.jacobian), 0.75 * limb_stiffness(rigid, posture.jacobian)
    )


def test_compliance_is_what_joint_springs_give(posture: Posture) -> None:
    """A small force turns the joints by k^-1 J^T f; the toe moves by C f, to first order."""
    robot = replace(posture.robot, structural_compliance_share=0.0)
    rng = np.random.default_rng(1)
    force = 1e-3 * rng.normal(size=posture.arms.shape)
    torque = np.einsum("...ji,...j->...i", posture.jacobian, force)
    turned = posture.angles + torque / robot.joint_stiffness
    zero = np.zeros((5, 3))
    moved = toe_world(robot, zero, posture.rpy, turned) - posture.arms
    expected = np.einsum("...ij,...j->...i", limb_compliance(robot, posture.jacobian), force)
    np.testing.assert_allclose(moved, expected, atol=1e-3 * np.abs(expected).max())


def test_rigid_motion_is_the_derivative_of_a_rotation(posture: Posture) -> None:
    small = 1e-6 * np.array([0.3, -0.2, 0.5])
    turned = posture.arms @ rotation_world_body(small).T - posture.arms
    motion = np.concatenate([np.zeros(3), small])
    np.testing.assert_allclose(rigid_motion(posture.arms) @ motion, turned, atol=1e-11)


def test_deflection_and_forces_are_in_equilibrium_and_at_least_energy(posture: Posture) -> None:
    """Eqs. (4.14) and (4.17): the forces carry the load, and the springs' energy is stationary."""
    rng = np.random.default_rng(2)
    stiffness = limb_stiffness(posture.robot, posture.jacobian)
    wall = 0.02 * rng.normal(size=posture.arms.shape)
    load = rng.normal(size=(5, 6)) * [60, 60, 60, 5, 5, 5]
    com = body_deflection(stiffness, posture.arms, wall, load)
    force = contact_forces(stiffness, posture.arms, wall, com)
    np.testing.assert_allclose(wrench_of(posture.arms, force) + load, 0, atol=1e-8)

    def energy(com: Array) -> Array:
        stretch = wall - np.einsum("...nij,...j->...ni", rigid_motion(posture.arms), com)
        return 0.5 * np.einsum("...ni,...nij,...nj->...", stretch, stiffness, stretch) - (
            load * com
        ).sum(axis=-1)

    step = 1e-4
    for axis in np.eye(6):
        slope = (energy(com + step * axis) - energy(com - step * axis)) / (2 * step)
        np.testing.assert_allclose(slope, 0, atol=1e-6)
        bend = (energy(com + step * axis) - 2 * energy(com) + energy(com - step * axis)) / step**2
        whole = whole_body_stiffness(stiffness, posture.arms)
        np.testing.assert_allclose(bend, np.einsum("i,kij,j->k", axis, whole, axis), rtol=1e-3)


def test_whole_body_stiffness_is_symmetric_positive_definite(posture: Posture) -> None:
    stiffness = limb_stiffness(posture.robot, posture.jacobian)
    whole = whole_body_stiffness(stiffness, posture.arms)
    np.testing.assert_allclose(whole, np.swapaxes(whole, -1, -2), atol=1e-9)
    assert np.linalg.eigvalsh(whole).min() > 0


@pytest.mark.parametrize("compensated", [False, True])
def test_deflections_reproduce_their_forces(posture: Posture, compensated: bool) -> None:
    rng = np.random.default_rng(3)
    contact = np.ones(posture.arms.shape[:2], bool)
    contact[:, 0] = False
    force = 30 * rng.normal(size=posture.arms.shape) * contact[..., None]
    compliance = limb_compliance(posture.robot, posture.jacobian)
    found = deflections_for_forces(compliance, posture.arms, force, contact, compensated)
    stiffness = limb_stiffness(posture.robot, posture.jacobian) * contact[..., None, None]
    back = contact_forces(stiffness, posture.arms, found.wall, found.com)
    np.testing.assert_allclose(back, force, atol=1e-7)
    assert (found.wall[:, 0] == 0).all()
    if compensated:
        assert (found.com == 0).all()
    else:  # no other body deflection needs less wall deflection
        motion = rigid_motion(posture.arms) * contact[..., None, None]
        slope = np.einsum("...nij,...ni->...j", motion, found.wall)
        np.testing.assert_allclose(slope, 0, atol=1e-7 * np.abs(found.wall).max())


def test_contacts_in_a_line_leave_the_body_unturned_about_it(posture: Posture) -> None:
    compliance = limb_compliance(posture.robot, posture.jacobian)
    arms = np.zeros_like(posture.arms)
    arms[..., 0] = np.linspace(-0.6, 0.6, arms.shape[1])
    force = np.random.default_rng(4).normal(size=arms.shape)
    contact = np.ones(arms.shape[:2], bool)
    found = deflections_for_forces(compliance, arms, force, contact, compensated=False)
    assert np.abs(found.com[:, 3]).max() < 1e-6
    assert np.isfinite(found.wall).all()


def test_a_stretched_limb_has_a_compliance_but_no_stiffness(
    braced_robot: Callable[..., RobotSpec],
) -> None:
    robot = Robot.from_spec(braced_robot(4))
    angles = np.zeros((4, 3))
    angles[:, 2] = np.pi / 2  # femur and tibia in a line
    jacobian = jacobian_world(robot, np.zeros(3), angles)
    with pytest.raises(SingularPosture):
        limb_stiffness(robot, jacobian)
    arms = toe_world(robot, np.zeros(3), np.zeros(3), angles)
    force = np.full((4, 3), 10.0)
    compliance = limb_compliance(robot, jacobian)
    found = deflections_for_forces(compliance, arms, force, np.ones(4, bool), compensated=False)
    assert np.isfinite(found.wall).all()
    assert np.abs(found.wall).max() < 5.0
