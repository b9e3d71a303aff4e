"""A quadruped from a URDF as walking has it: mass, inertia, axes, boxes of toes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker
from walking_urdf import walking_robot, write_robot

from climbplan.errors import SpecError
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.toe_boxes import compute_weight_fractions
from climbplan.robots.urdf.walking_body import TO_WALKING, WalkingBody, build_walking_body
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

pytest.importorskip("pinocchio")
QUADRUPED = Walker()
TEN = (0.4, 0.2, 0.0, -0.2, -0.4)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> UrdfRobot:
    return walking_robot(tmp_path_factory.mktemp("walker"))


@pytest.fixture(scope="module")
def found(robot: UrdfRobot) -> WalkingBody:
    return build_walking_body(robot)


def test_masses_and_inertia_are_those_of_all_links(robot: UrdfRobot, found: WalkingBody) -> None:
    model = build_urdf_model(robot)
    pin, data = model.library, model.model.createData()
    standing = {
        name: float(angle)
        for own, row in zip(found.legs.chain.names, found.legs.chain.posture, strict=True)
        for name, angle in zip(own, row, strict=True)
    }
    pin.forwardKinematics(model.model, data, model.build_configuration(standing))
    masses, middles, turned = [], [], []
    for joint in range(1, model.model.njoints):
        inertia, place = model.model.inertias[joint], data.oMi[joint]
        masses.append(inertia.mass)
        middles.append(place.translation + place.rotation @ inertia.lever)
        turned.append(place.rotation @ inertia.inertia @ place.rotation.T)
    mass = np.array(masses)
    away = np.array(middles) - (mass @ np.array(middles)) / mass.sum()
    about = sum(turned) + sum(
        m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(mass, away, strict=True)
    )
    turn = TO_WALKING @ model.root_to_base_rotation
    assert found.mass == pytest.approx(pin.computeTotalMass(model.model), rel=1e-9)
    np.testing.assert_allclose(found.inertia, turn @ about @ turn.T, atol=1e-9)


def test_legs_stand_where_their_names_in_walking_say(found: WalkingBody) -> None:
    assert found.leg_names == ("L1", "R1", "L2", "R2")
    toes = found.boxes.center
    assert (np.sign(toes[:, :2]) == [[1, 1], [1, -1], [-1, 1], [-1, -1]]).all()
    assert found.height == pytest.approx(-toes[:, 2].mean())
    stood = found.legs.chain.joint_points(found.legs.chain.posture)[:, -1]
    np.testing.assert_allclose(stood, toes, atol=1e-12)


def test_boxes_are_reached_and_held_at_points_that_were_not_looked_at(found: WalkingBody) -> None:
    legs, boxes = found.legs, found.boxes
    assert (boxes.half > 0.02).all()
    drawn = np.random.default_rng(99).uniform(-1, 1, (400, 4, 3)) * boxes.half
    solution = legs.chain.inverse(boxes.center + drawn, legs.lower, legs.upper)
    assert solution.valid.all()
    upward = np.abs(legs.chain.jacobian(solution.best())[..., 2, :])
    most = (legs.max_torque / np.maximum(upward, 1e-9)).min()
    assert most > 0.98 * boxes.force
    assert boxes.force >= 0.5 * found.mass * found.gravity


def test_legs_of_four_joints_walk(tmp_path: Path) -> None:
    found = build_walking_body(walking_robot(tmp_path, Walker(joints=4)))
    assert found.legs.max_torque.shape == found.legs.chain.posture.shape == (4, 4)
    assert (found.boxes.half > 0.02).all()


def test_legs_of_different_numbers_of_joints_walk(tmp_path: Path) -> None:
    locked = "locked: {L2_ankle: 0, R2_ankle: 0}"
    robot = walking_robot(tmp_path, Walker(joints=4), locked)
    found = build_walking_body(robot)
    assert found.legs.there.sum(axis=1).tolist() == [4, 4, 3, 3]
    assert (found.boxes.half > 0.02).all()
    # Hind legs are those of a robot whose legs all have three joints
    short = "locked: {L1_ankle: 0, R1_ankle: 0, L2_ankle: 0, R2_ankle: 0}"
    (tmp_path / "alike").mkdir()
    alike = build_walking_body(walking_robot(tmp_path / "alike", Walker(joints=4), short))
    np.testing.assert_allclose(found.boxes.center, alike.boxes.center, atol=1e-12)
    jacobian = found.legs.chain.jacobian(found.legs.chain.posture)
    np.testing.assert_allclose(
        jacobian[2:, :, 1:], alike.legs.chain.jacobian(alike.legs.chain.posture)[2:], atol=1e-12
    )
    assert not jacobian[2:, :, 0].any()


def test_legs_have_three_joints_at_least(tmp_path: Path) -> None:
    path = write_robot(tmp_path, Walker(joints=3), "locked: {R1_knee: 10}")
    path.write_text(path.read_text().replace(", R1_knee: 10", ""))
    with pytest.raises(SpecError, match=r"[0-9] joints"):
        build_walking_body(_loaded(path))


def _loaded(path: Path) -> UrdfRobot:
    robot = load_any_robot(path)
    assert isinstance(robot, UrdfRobot)
    return robot


def test_weaker_legs_bear_less_farther_from_the_middle(found: WalkingBody) -> None:
    share = compute_weight_fractions(found.boxes.center + np.array([0.1, 0.0, 0.0]))
    assert share.sum() == pytest.approx(2.0)
    assert share[0] == share[1] < 0.5 < share[2] == share[3]


@pytest.mark.parametrize(
    ("walker", "more", "words"),
    [
        (Walker(forward=TEN, sprawl_deg=(0.0,) * 5), "", "four, six or eight legs, got 10"),
        (Walker(effort=3.0), "", "cannot hold its part of the weight within its torque limits"),
        (QUADRUPED, "gravity: 0", "expected more than 0 to walk"),
    ],
)
def test_what_cannot_walk_is_refused(tmp_path: Path, walker: Walker, more: str, words: str) -> None:
    with pytest.raises(SpecError, match=words):
        build_walking_body(walking_robot(tmp_path, walker, more))
