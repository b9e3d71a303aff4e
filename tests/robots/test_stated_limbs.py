"""Limbs as programs state them: the same numbers as the robot's own kinematics, for every kind."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from random_chains import random_robot

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.mechanics.equilibrium import link_torques
from climbplan.robots.any_robot import build_robot
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import jacobian_body, joint_points_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.symbolic_chains import SymbolicChains
from climbplan.robots.symbolic_limbs import SymbolicLimbs
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.schema.robots.source import load_any_robot

SPECS = Path(__file__).parents[2] / "specs"
ROBOTS = ["silvia", "robot_walker.yaml"]


@cache
def robot_of(name: str) -> Robot:
    return build_robot(load_any_robot(name, SPECS))


def posture_of(robot: Robot) -> Array:
    """Joint angles near those of the robot's stance, (N, J)."""
    at_stance = robot.limbs.inverse(robot.stance_body, robot.joint_lower, robot.joint_upper).best()
    drawn = np.random.default_rng(1).uniform(-0.1, 0.1, at_stance.shape)
    return np.where(robot.has_joint, at_stance + drawn, 0.0)


def numbers_of(robot: Robot, stated: SymbolicLimbs) -> dict[str, ca.DM]:
    values = stated.compute_robot_parameters(robot)
    assert {name: np.shape(v) for name, v in values.items()} == stated.robot_parameter_shapes
    return {name: ca.DM(v) for name, v in values.items()}


def value(expression: object) -> Array:
    """(N, rows) of a matrix with one column a limb."""
    return np.array(ca.evalf(ca.SX(expression))).T


@pytest.mark.parametrize("name", ROBOTS)
def test_joints_links_and_toes_are_the_robots(name: str) -> None:
    robot = robot_of(name)
    stated = build_symbolic_limbs(robot)
    assert (stated.limbs, stated.joints) == (robot.limb_count, robot.joint_count)
    angles = posture_of(robot)
    numbers = numbers_of(robot, stated)
    points = np.stack([value(p) for p in stated.points(numbers, ca.DM(angles.T))], axis=1)
    np.testing.assert_allclose(points, joint_points_body(robot, angles), atol=1e-12)
    pieces = stated.pieces(numbers, ca.DM(angles.T))
    links = limb_capsules(robot, angles)
    for number, ends in enumerate(pieces):
        np.testing.assert_allclose(value(ends[0]), links.starts[:, number], atol=1e-12)
        np.testing.assert_allclose(value(ends[1]), links.ends[:, number], atol=1e-12)
    assert len(pieces) == links.radius.shape[1]


@pytest.mark.parametrize("name", ROBOTS)
def test_torques_and_free_toes_at_toes_in_reach(name: str) -> None:
    robot = robot_of(name)
    stated, numbers = build_symbolic_limbs(robot), numbers_of(robot, build_symbolic_limbs(robot))
    toes = joint_points_body(robot, posture_of(robot))[:, -1]
    own = stated.at_toes(robot, toes)
    given = {n: ca.DM(v.T) for n, v in own.items()}
    standing = stated.standing(numbers, ca.DM(toes.T), given)
    angles = value(standing.angles)
    np.testing.assert_allclose(joint_points_body(robot, angles)[:, -1], toes, atol=1e-8)
    force = np.random.default_rng(2).normal(size=toes.shape)
    expected = np.einsum("nij,ni->nj", jacobian_body(robot, angles), force)
    np.testing.assert_allclose(value(standing.torques(ca.DM(force.T))), expected, atol=1e-7)
    bent = np.where(robot.has_joint, 0.05, 0.0)
    free = joint_points_body(robot, angles - bent)[:, -1]
    np.testing.assert_allclose(value(standing.free_toes(ca.DM(bent.T))), free, atol=1e-8)
    # What ties limbs to their toes holds there, and not beside it
    off = stated.standing(numbers, ca.DM((toes + np.array([0.0, 0.0, 0.05])).T), given)
    for tie, beside in zip(standing.ties(0.0), off.ties(0.0), strict=True):
        rows = value(tie.rows)
        if tie.lower is not None and tie.upper is not None:
            assert (rows >= tie.lower - 1e-6).all()
            assert (rows <= tie.upper + 1e-6).all()
        if tie.name == "kinematics.forward":
            np.testing.assert_allclose(value(beside.rows)[:, 2], -0.05, atol=1e-8)


def test_a_limb_with_freedom_to_choose_is_told_which_angles() -> None:
    """Angles that put the toe there but are not the nearest to the posture do not hold."""
    robot = robot_of("robot_walker.yaml")
    stated, numbers = build_symbolic_limbs(robot), numbers_of(robot, build_symbolic_limbs(robot))
    assert "pull" in stated.variable_shapes
    toes = robot.stance_body
    own = stated.at_toes(robot, toes)
    jacobian = jacobian_body(robot, own["angles"])
    aside = np.linalg.svd(jacobian)[2][:, -1]  # (N, J) turns that leave the toe where it is
    given = {"angles": ca.DM((own["angles"] + 0.01 * aside).T), "pull": ca.DM(own["pull"].T)}
    ties = {t.name: t for t in stated.standing(numbers, ca.DM(toes.T), given).ties(0.0)}
    assert np.abs(value(ties["kinematics.forward"].rows)).max() < 1e-3
    assert (np.abs(value(ties["kinematics.settled"].rows)).max(axis=1) > 1e-3).all()


def test_room_keeps_chains_off_full_stretch(tmp_path: Path) -> None:
    """Of any joints, by the singular values of the Jacobian in units of its angles."""
    for robot in (robot_of("robot_walker.yaml"), random_robot(tmp_path, 3)[1]):
        chain = robot.mechanism
        assert isinstance(chain, SerialChain)
        stated, numbers = (
            build_symbolic_limbs(robot),
            numbers_of(robot, build_symbolic_limbs(robot)),
        )
        angles = posture_of(robot)
        own = {"angles": ca.DM(angles.T), "pull": ca.DM.zeros(3, robot.limb_count)}
        standing = stated.standing(numbers, ca.DM.zeros(3, robot.limb_count), own)
        (reach,) = (tie for tie in standing.ties(1e-4) if tie.name == "transition.reach")
        singular = np.linalg.svd(chain.jacobian(angles) * chain.zero.unit[:, None, :])[1]
        size = np.linalg.norm(singular, axis=1)
        expected = 1 / (size * np.linalg.norm(1 / singular, axis=1))
        np.testing.assert_allclose(value(reach.rows)[:, 0], expected, rtol=1e-4)
        assert (expected <= singular[:, -1] / size).all()
        assert (expected >= singular[:, -1] / size / np.sqrt(3)).all()


def test_room_of_two_equal_links_is_that_of_the_cosine_of_their_knee() -> None:
    stated, room = SymbolicChains(1, 3, redundant=False), 1e-3
    numbers = {
        "joint_zero": ca.DM([[0, 0, 0], [0, 0, 0], [0, 0, -0.3]]).T,
        "axis_zero": ca.DM([[1, 0, 0], [0, 1, 0], [0, 1, 0]]).T,
        "toe_zero": ca.DM([0, 0, -0.6]),
        "posture": ca.DM.zeros(3, 1),
    }
    for part, knee in itertools.product((0.5, 1.0, 2.0), (1.0, -1.0)):
        angles = ca.DM([0.0, 0.0, knee * np.arccos(1 - part * room)])
        reach = {}
        for side in (1.0, -1.0):
            own = {"angles": angles, "side": ca.DM(side)}
            ties = stated.standing(numbers, ca.DM.zeros(3, 1), own).ties(room)
            (reach[side],) = (tie for tie in ties if tie.name == "transition.reach")
        least, row = reach[1.0].lower, value(reach[1.0].rows)
        assert least is not None
        np.testing.assert_allclose(row**2, part * least**2, rtol=2e-3)
        # A knee that bends the other way is on the other side
        np.testing.assert_allclose(value(reach[-1.0].rows), -row)


def test_links_weigh_in_programs_what_they_weigh(tmp_path: Path) -> None:
    for robot in (robot_of("robot_walker.yaml"), random_robot(tmp_path, 4)[1]):
        assert robot.links is not None
        stated, numbers = (
            build_symbolic_limbs(robot),
            numbers_of(robot, build_symbolic_limbs(robot)),
        )
        angles = posture_of(robot)
        own = {"angles": ca.DM(angles.T), "pull": ca.DM.zeros(3, robot.limb_count)}
        standing = stated.standing(numbers, ca.DM.zeros(3, robot.limb_count), own)
        centre = value(standing.centre())[0]
        np.testing.assert_allclose(centre, robot.centre_of_mass(angles), atol=1e-12)
        rpy = np.array([0.2, -0.3, 0.5])
        down = ca.DM(-rotation_world_body(rpy)[2])
        torques = value(standing.weight_torques(down)) * robot.weight
        np.testing.assert_allclose(torques, link_torques(robot, rpy, angles), atol=1e-9)


def test_closed_linkages_are_refused() -> None:
    with pytest.raises(UsageError, match="closed linkages"):
        build_symbolic_limbs(robot_of("scaler"))
