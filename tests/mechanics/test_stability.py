"""Stiffness under load against exact kinematics, and against a strut that buckles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.arrays import Array
from climbplan.mechanics.stability import (
    BracedBody,
    braced_body,
    loaded_stiffness,
    stiffness_lost,
    stiffness_lost_matrices,
)
from climbplan.mechanics.stiffness import joint_bending, joint_softness, limb_compliance
from climbplan.robots.kinematics import (
    jacobian_body,
    jacobian_world,
    solve_inverse_kinematics,
    toe_world,
)
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.schema.robots.robot import RobotSpec

RobotMaker = Callable[..., RobotSpec]
STEP = 1e-6


class Held:
    """A braced robot, its joints springs that push with given forces at the pose it starts from."""

    def __init__(self, robot: Robot, force: Array) -> None:
        self.robot, self.force = robot, force
        stance = robot.stance_body
        self.angles = solve_inverse_kinematics(robot, stance).best()
        self.rpy = np.zeros(3)
        self.toes = toe_world(robot, np.zeros(3), self.rpy, self.angles)
        jacobian = jacobian_world(robot, self.rpy, self.angles)
        torque = np.einsum("nij,ni->nj", jacobian, force)
        self.command = self.angles - joint_softness(robot) * torque
        self.jacobian = jacobian

    def wrench(self, com: Array, turn: Array) -> Array:
        """Of the contact forces about the body, moved and slightly turned."""
        size = np.linalg.norm(turn)
        axis = skew(turn / size) if size > 0 else np.zeros((3, 3))
        rotation = np.eye(3) + np.sin(size) * axis + (1 - np.cos(size)) * axis @ axis
        angles = solve_inverse_kinematics(self.robot, (self.toes - com) @ rotation).best()
        jacobian = rotation @ jacobian_body(self.robot, angles)
        torque = (angles - self.command) / joint_softness(self.robot)
        force = np.linalg.solve(np.swapaxes(jacobian, 1, 2), torque[..., None])[..., 0]
        return np.append(force.sum(axis=0), np.cross(self.toes - com, force).sum(axis=0))

    def stiffness(self) -> Array:
        """(6, 6) by difference quotients."""
        columns = []
        for axis in np.eye(6):
            ahead = self.wrench(STEP * axis[:3], STEP * axis[3:])
            behind = self.wrench(-STEP * axis[:3], -STEP * axis[3:])
            columns.append((behind - ahead) / (2 * STEP))
        return np.stack(columns, axis=1)

    def braced(self) -> BracedBody:
        contact = np.ones((1, self.robot.limb_count), bool)
        return braced_body(
            self.robot,
            self.rpy[None],
            self.angles[None],
            self.jacobian[None],
            self.toes[None],
            contact=contact,
            normal=np.zeros((1, *self.toes.shape)),
        )


def pushing(robot: Robot, strength: float) -> Array:
    """Forces towards the body and a load on all limbs, without a moment."""
    inward = np.sign(robot.stance_body[:, 0])
    force = np.zeros((robot.limb_count, 3))
    force[:, 0] = (
        -strength * inward / np.bincount((inward > 0).astype(int))[(inward > 0).astype(int)]
    )
    return force


def test_loaded_stiffness_is_the_slope_of_the_wrench(braced_robot: RobotMaker) -> None:
    for limbs in (4, 6):
        robot = Robot.from_spec(braced_robot(limbs, seed=limbs))
        held = Held(robot, pushing(robot, 80.0))
        body = held.braced()
        slope = held.stiffness()
        even = (slope + slope.T) / 2
        value = np.linalg.eigvalsh(body.whitening[0].T @ even @ body.whitening[0])
        found = loaded_stiffness(body, held.force[None])
        np.testing.assert_allclose(found.left[0], value[0], atol=1e-5)
        v = found.direction[0]
        np.testing.assert_allclose(v @ even @ v, found.left[0], atol=1e-5)
        np.testing.assert_allclose(v @ body.elastic[0] @ v, 1.0, atol=1e-9)


def test_rows_and_matrices_agree_with_the_eigenvalue(braced_robot: RobotMaker) -> None:
    robot = Robot.from_spec(braced_robot(6, seed=2))
    held = Held(robot, pushing(robot, 60.0))
    body, force = held.braced(), held.force[None]
    found = loaded_stiffness(body, force)
    lost = stiffness_lost(body, np.array([0]), found.direction)
    assert np.isclose(1 - (lost * force).sum(), found.left[0], atol=1e-12)
    matrices = stiffness_lost_matrices(body, np.array([0]))
    whole = np.eye(6) - np.einsum("rniab,rni->ab", matrices, force)
    np.testing.assert_allclose(np.linalg.eigvalsh(whole)[0], found.left[0], atol=1e-12)


def test_pushing_ever_harder_buckles(braced_robot: RobotMaker) -> None:
    """Legs that push take stiffness away in proportion: some strength takes all of it."""
    robot = Robot.from_spec(braced_robot(6, seed=2))
    body = Held(robot, pushing(robot, 1.0)).braced()
    left = [
        float(loaded_stiffness(body, pushing(robot, strength)[None]).left[0])
        for strength in (0.0, 50.0, 100.0, 2000.0)
    ]
    assert np.isclose(left[0], 1.0)
    assert np.isclose(1 - left[2], 2 * (1 - left[1]))
    assert left[-1] < 0


def test_commands_press_with_the_forces(braced_robot: RobotMaker) -> None:
    """Exactly, at the planned pose; with a body that sags, to first order."""
    robot = Robot.from_spec(braced_robot(6, seed=1))
    force = pushing(robot, 30.0)
    held = Held(robot, force)
    contact = np.ones((1, 6), bool)
    arms, jacobian = held.toes[None], held.jacobian[None]
    exact = joint_bending(robot, jacobian, arms, contact, compensated=True)
    bent = np.einsum("kniml,kml->kni", exact, force[None])
    np.testing.assert_allclose(held.angles - bent[0], held.command, atol=1e-12)
    sagging = joint_bending(robot, jacobian, arms, contact, compensated=False)
    imposed = np.einsum(
        "knij,knj->kni", jacobian, np.einsum("kniml,kml->kni", sagging, force[None])
    )
    own = np.einsum("knij,knj->kni", limb_compliance(robot, jacobian), force[None])
    # What is imposed beyond the limbs' own compliance is a rigid motion, and makes it less.
    assert np.linalg.norm(imposed) < np.linalg.norm(own)
    motion = np.concatenate(
        [np.broadcast_to(np.eye(3), (6, 3, 3)), -skew(arms[0])], axis=-1
    ).reshape(18, 6)
    _, residual, *_ = np.linalg.lstsq(motion, (imposed - own).ravel(), rcond=None)
    assert residual[0] < 1e-20


def test_rotation_is_the_models(braced_robot: RobotMaker) -> None:
    """A turned robot in a turned world has the same stiffness left."""
    robot = Robot.from_spec(braced_robot(6, seed=3))
    held = Held(robot, pushing(robot, 60.0))
    left = loaded_stiffness(held.braced(), held.force[None]).left
    rpy = np.array([[0.3, -0.2, 0.5]])
    rotation = rotation_world_body(rpy[0])
    turned = braced_body(
        robot,
        rpy,
        held.angles[None],
        jacobian_world(robot, rpy, held.angles[None]),
        held.toes[None] @ rotation.T,
        contact=np.ones((1, 6), bool),
        normal=np.zeros((1, *held.toes.shape)),
    )
    np.testing.assert_allclose(
        loaded_stiffness(turned, held.force[None] @ rotation.T).left, left, atol=1e-9
    )
