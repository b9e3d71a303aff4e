"""Joints that slide and joints that mimic others, against Pinocchio and against one another."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio
import pytest
from random_chains import random_robot

from climbplan.climb.check.anew.chains import build_chains
from climbplan.robots.kinematics import (
    jacobian_body,
    solve_inverse_kinematics,
    toe_body,
    toe_hessian,
)
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.schema.robots.urdf.robot import UrdfRobot


def chain_of(robot: Robot) -> SerialChain:
    assert isinstance(robot.mechanism, SerialChain)
    return robot.mechanism


def by_name(robot: Robot, angles: Any) -> dict[str, float]:
    """Angles of the joints that have some."""
    names = robot.limbs.joint_names
    return {
        name: float(angles[limb, joint])
        for limb, own in enumerate(names)
        for joint, name in enumerate(own)
        if name
    }


def toes_of(found: UrdfModel, q: Any) -> Any:
    """Toes as Pinocchio has them, from the base link in its turned axes."""
    data = found.model.createData()
    pinocchio.framesForwardKinematics(found.model, data, q)
    frames = [data.oMf[found.model.getFrameId(leg.toe)] for leg in found.robot.spec.legs.values()]
    return found.to_base_axes(np.array([frame.translation for frame in frames]))


def drawn(robot: Robot, seed: int) -> Any:
    share = np.random.default_rng(seed).uniform(-1, 1, robot.joint_lower.shape)
    size = np.where(robot.slides, 0.4, 1.5)
    return np.where(robot.has_joint, share * size, 0.0)


@pytest.fixture(scope="module", params=range(4))
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return random_robot(tmp_path_factory.mktemp("chains"), request.param)


def test_toes_and_torques_are_pinocchios(both: tuple[UrdfRobot, Robot]) -> None:
    """Torques of forces at toes, weight of nothing: the generalised forces J^T f of RNEA."""
    spec, robot = both
    found = build_urdf_model(spec)
    assert robot.mass == pytest.approx(sum(link.mass for link in spec.tree.links.values()))
    shift = found.read_leg("L0").joints[0] - chain_of(robot).joint_zero[0, -len(spec.joints["L0"])]
    rng = np.random.default_rng(7)
    for draw in range(5):
        angles = drawn(robot, draw)
        q = found.build_configuration(by_name(robot, angles))
        np.testing.assert_allclose(toe_body(robot, angles) + shift, toes_of(found, q), atol=1e-9)
        force = rng.normal(size=(robot.limb_count, 3)) * 50
        own = np.einsum("nij,ni->nj", jacobian_body(robot, angles), force)
        wanted = rnea_of_forces(found, q, force)
        for limb, names in enumerate(chain_of(robot).names):
            told = sums_by_leader(spec, found, wanted, names)
            for joint, name in enumerate(robot.limbs.joint_names[limb]):
                assert own[limb, joint] == pytest.approx(told.get(name, 0.0), abs=1e-6)


def rnea_of_forces(found: UrdfModel, q: Any, force: Any) -> Any:
    """What forces on toes do to all joints by Pinocchio's RNEA, without weight."""
    model = found.model.copy()
    model.gravity = pinocchio.Motion.Zero()
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    loads = pinocchio.StdVec_Force()
    for _ in range(model.njoints):
        loads.append(pinocchio.Force.Zero())
    for leg, own in zip(found.robot.spec.legs.values(), force, strict=True):
        frame = model.frames[model.getFrameId(leg.toe)]
        world = found.root_to_base_rotation.T @ own
        at = data.oMf[model.getFrameId(leg.toe)].translation
        joint = frame.parentJoint
        spatial = pinocchio.Force(world, np.cross(at, world))
        loads[joint] += data.oMi[joint].actInv(spatial)
    still = np.zeros(model.nv)
    return -pinocchio.rnea(model, data, q, still, still, loads)


def sums_by_leader(
    spec: UrdfRobot, found: UrdfModel, torque: Any, names: tuple[str, ...]
) -> dict[str, float]:
    """Of a leg's joints, those that mimic others added to these by how far they move."""
    told: dict[str, float] = {}
    for name in filter(None, names):
        own = float(torque[found.model.idx_vs[found.model.getJointId(name)]])
        mimic = spec.tree.joints[name].mimic
        leader, ratio = (name, 1.0) if mimic is None else (mimic.joint, mimic.multiplier)
        told[leader] = told.get(leader, 0.0) + ratio * own
    return told


def test_derivatives(both: tuple[UrdfRobot, Robot]) -> None:
    _, robot = both
    angles, step = drawn(robot, 3), 1e-6
    jacobian, hessian = jacobian_body(robot, angles), toe_hessian(robot, angles)
    for joint in range(robot.joint_count):
        more, less = angles.copy(), angles.copy()
        more[:, joint] += step
        less[:, joint] -= step
        slope = (toe_body(robot, more) - toe_body(robot, less)) / (2 * step)
        np.testing.assert_allclose(jacobian[..., joint], slope, atol=1e-7)
        bend = (jacobian_body(robot, more) - jacobian_body(robot, less)) / (2 * step)
        np.testing.assert_allclose(hessian[..., joint], bend, atol=1e-7)


def test_the_checker_and_programs_have_the_same_limbs(both: tuple[UrdfRobot, Robot]) -> None:
    """Three times written: planning's product of exponentials, the checker's, and CasADi's."""
    _, robot = both
    chain, angles = chain_of(robot), drawn(robot, 5)
    pose, anew = chain.pose(angles), build_chains(chain, angles)
    np.testing.assert_allclose(anew.toe, pose.toe, atol=1e-12)
    np.testing.assert_allclose(anew.joints, pose.joints, atol=1e-12)
    np.testing.assert_allclose(anew.jacobian(), pose.jacobian, atol=1e-12)
    force = np.random.default_rng(1).normal(size=(robot.limb_count, 3))
    curved = np.einsum("ni,nijk->njk", force, pose.hessian)
    np.testing.assert_allclose(anew.compute_force_hessian(force), curved, atol=1e-12)
    stated = build_symbolic_limbs(robot)
    numbers = {name: ca.DM(value) for name, value in stated.compute_robot_parameters(robot).items()}
    own = {"angles": ca.DM(angles.T), "pull": ca.DM.zeros(3, robot.limb_count)}
    standing = stated.standing(numbers, ca.DM(pose.toe.T), own)
    np.testing.assert_allclose(np.array(standing.ties(0.0)[0].rows), 0.0, atol=1e-12)
    torque = np.array(standing.torques(ca.DM(force.T))).T
    np.testing.assert_allclose(torque, np.einsum("nij,ni->nj", pose.jacobian, force), atol=1e-12)


def test_toes_are_no_farther_than_links_are_long(both: tuple[UrdfRobot, Robot]) -> None:
    """What proofs that a toe is out of reach rest on: slides are out as far as they go."""
    _, robot = both
    share = np.random.default_rng(2).random((3000, *robot.joint_lower.shape))
    ends = np.where(share < 0.4, 0.0, np.where(share > 0.6, 1.0, share))
    drawn_angles = robot.joint_lower + ends * (robot.joint_upper - robot.joint_lower)
    far = np.linalg.norm(toe_body(robot, drawn_angles) - robot.shoulder_body, axis=-1).max(axis=0)
    assert (far <= robot.longest_links.sum(axis=1) + 1e-9).all()
    assert (far > robot.link_lengths.sum(axis=1)).any()


def test_inverse_is_nearest_to_the_posture(both: tuple[UrdfRobot, Robot]) -> None:
    """Least sum of squares with 0.25 m for a radian: what is off it is J^T of some pull."""
    _, robot = both
    chain = chain_of(robot)
    toes = chain.pose(0.15 * drawn(robot, 8) + chain.posture).toe
    solution = solve_inverse_kinematics(robot, toes)
    assert solution.valid.all()
    angles = solution.best()
    np.testing.assert_allclose(toe_body(robot, angles), toes, atol=1e-8)
    assert (angles[~robot.has_joint] == 0.0).all()
    unit = robot.joint_unit
    away = (angles - chain.posture) / unit
    turns = chain.jacobian(angles) * unit[:, None, :]
    for limb in range(robot.limb_count):
        pulled = turns[limb].T @ np.linalg.pinv(turns[limb].T) @ away[limb]
        np.testing.assert_allclose(away[limb], pulled, atol=1e-6)


def test_programs_settle_as_the_inverse_does(both: tuple[UrdfRobot, Robot]) -> None:
    _, robot = both
    stated = build_symbolic_limbs(robot)
    toes = toe_body(robot, 0.1 * drawn(robot, 9))
    found = {name: ca.DM(value.T) for name, value in stated.at_toes(robot, toes).items()}
    numbers = {name: ca.DM(value) for name, value in stated.compute_robot_parameters(robot).items()}
    for tie in stated.standing(numbers, ca.DM(toes.T), found).ties(0.0):
        np.testing.assert_allclose(np.array(tie.rows), 0.0, atol=1e-6)
