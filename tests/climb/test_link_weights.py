"""Planning and verification count what links weigh where it acts, as Pinocchio has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest

from climbplan.climb.check.anew.kinematics import compute_body_axes
from climbplan.climb.check.anew.weights import compute_link_torques as torques_anew
from climbplan.climb.check.anew.weights import compute_weight_wrench
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found, read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import LoadedClimb, load_climb
from climbplan.errors import PlanFileError, SpecError
from climbplan.mechanics.equilibrium import link_torques, total_load
from climbplan.robots.any_robot import build_robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

SPECS = Path(__file__).parents[2] / "specs"


@pytest.fixture(scope="module", name="loaded")
def _loaded() -> LoadedClimb:
    return load_climb(SPECS / "climb_biped.yaml", ["task.rounds=1", "task.goal.com=[0,0.1,0.52]"])


@pytest.fixture(scope="module", name="plan")
def _plan(loaded: LoadedClimb) -> ClimbPlan:
    return plan_climb(loaded)


@pytest.mark.parametrize("name", ["robot_walker", "robot_biped", "robot_telescope"])
def test_centre_of_mass_and_torques_are_pinocchios(name: str) -> None:
    given = load_any_robot(SPECS / f"{name}.yaml")
    assert isinstance(given, UrdfRobot)
    robot, found = build_robot(given), build_urdf_model(given)
    assert robot.links is not None
    assert robot.links.mass.sum() + robot.links.body_mass == pytest.approx(robot.mass, abs=1e-12)
    assert isinstance(robot.mechanism, SerialChain)
    names, posture = robot.limbs.joint_names, robot.mechanism.posture
    zero = np.zeros(posture.shape)
    rng = np.random.default_rng(3)
    angles = rng.uniform(robot.joint_lower, robot.joint_upper, (5, *posture.shape))
    rpy = rng.uniform(-1.0, 1.0, (5, 3))
    told = link_torques(robot, rpy, angles)
    load = total_load(robot, np.zeros((5, 6)), rpy, angles)

    def named(row: np.ndarray) -> dict[str, float]:
        pairs = zip(np.concatenate(names), row.ravel(), strict=True)
        return {str(n): float(a) for n, a in pairs if n}

    for k in range(5):
        q = found.build_configuration(named(angles[k]))
        centre = robot.centre_of_mass(angles[k])
        moved = found.compute_center(named(angles[k])) - found.compute_center(named(zero))
        np.testing.assert_allclose(centre - robot.centre_of_mass(zero), moved, atol=1e-9)
        turned = rotation_world_body(rpy[k])
        moment = np.cross(turned @ centre, [0, 0, -robot.weight])
        np.testing.assert_allclose(load[k, 3:], moment, atol=1e-6)
        found.model.gravity.linear = -robot.gravity * (found.root_to_base_rotation.T @ turned[2])
        held = pin.computeGeneralizedGravity(found.model, found.model.createData(), q)
        for limb, own in enumerate(names):
            for joint, label in enumerate(own):
                if label:
                    index = found.model.idx_vs[found.model.getJointId(label)]
                    assert told[k, limb, joint] == pytest.approx(-held[index], abs=1e-6)
    # And as the checker has them, which computes them anew
    axes = compute_body_axes(rpy)
    np.testing.assert_allclose(compute_weight_wrench(robot, axes, angles), load, atol=1e-9)
    np.testing.assert_allclose(torques_anew(robot, axes, angles), told, atol=1e-9)


def test_what_a_robot_weighs_beside_its_urdf_acts_in_its_origin() -> None:
    given = load_any_robot(SPECS / "robot_biped.yaml")
    assert isinstance(given, UrdfRobot)
    lighter = build_robot(given)
    heavy = build_robot(replace(given, spec=given.spec.model_copy(update={"mass": 40.0})))
    for robot in (lighter, heavy):
        assert isinstance(robot.mechanism, SerialChain)
        posture = robot.mechanism.posture
        assert np.linalg.norm(robot.centre_of_mass(posture)) < 1e-5  # soles are made level
    light = given.spec.model_copy(update={"mass": 5.0})
    with pytest.raises(SpecError, match=r"expected more than the 8\.6 kg of its legs, got 5 kg"):
        build_robot(replace(given, spec=light))


def test_plans_balance_links_where_they_are(plan: ClimbPlan, tmp_path: Path) -> None:
    assert verify_plan(plan).passed
    assert plan.robot.links is not None
    centre = plan.robot.centre_of_mass(plan.instants.joint_angles)
    assert np.linalg.norm(centre, axis=1).max() > 0.01
    weightless = replace(plan, robot=replace(plan.robot, links=None))
    failed = {check.name for check in verify_plan(weightless).failed}
    assert {"force.equilibrium", "trajectory.command", "torque.from_forces"} <= failed
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    again = read_climb(path)
    assert again.robot.links is not None
    for name, value in vars(plan.robot.links).items():
        np.testing.assert_array_equal(vars(again.robot.links)[name], value)
    np.testing.assert_array_equal(again.forces.motor_torques, plan.forces.motor_torques)


@pytest.mark.parametrize(
    ("dataset", "failing"),
    [("robot/links/middle", "robot.spec"), ("instants/link_torques", "torque.from_forces")],
)
def test_other_numbers_of_links_are_found(
    plan: ClimbPlan, tmp_path: Path, dataset: str, failing: str
) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    with h5py.File(path, "r+") as file:
        file[dataset][0] += 0.01
    assert failing in {check.name for check in verify_plan(read_as_found(path)).failed}
    with h5py.File(path, "r+") as file:
        file["robot/links/mass"][0, 0] += 1.0
    with pytest.raises(PlanFileError, match=r"expected masses that are 16\.6 kg together"):
        read_as_found(path)


def test_plans_of_before_say_that_they_count_links_to_the_body(
    loaded: LoadedClimb, monkeypatch: pytest.MonkeyPatch
) -> None:
    def weightless(*arguments: object, **keys: object) -> object:
        scene = build_scene(*arguments, **keys)  # type: ignore[arg-type]
        return replace(scene, robot=replace(scene.robot, links=None))

    monkeypatch.setattr("climbplan.climb.planner.planner.build_scene", weightless)
    found = verify_plan(plan_climb(loaded))
    assert found.passed
    assert "links without mass" in found.model
    assert any("the weight of links, 52 % of all" in words for words in found.leaves_out)
