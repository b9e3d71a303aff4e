"""Legs with joints that slide, and that mimic others, climb; plans are verified and simulated."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import mujoco
import numpy as np
import pytest
from urdf_statics import Played

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.exports.motion import read_motion as climb_motion
from climbplan.climb.exports.table import export_csv
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found, read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.planner.summary import describe_min_safety
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.control.feedforward import compute_gravity_torques
from climbplan.climb.simulation.control.regulator import build_regulator_tables
from climbplan.climb.simulation.implicit_dynamics.engine import prepare_steps, simulate_steps
from climbplan.climb.simulation.implicit_dynamics.outcome import HAS_FALLEN
from climbplan.climb.simulation.model.chain_limb import (
    compute_drive,
    find_mimic_joints,
    name_motors,
)
from climbplan.climb.simulation.model.mjcf import build_mjcf, compute_link_mass
from climbplan.climb.simulation.replay import simulate
from climbplan.control.joint_regulator import build_chains
from climbplan.errors import PlanFileError, UsageError
from climbplan.exports.gains import read_gains
from climbplan.robots.kinematics import (
    joint_points_body,
    solve_inverse_kinematics,
    to_body,
    toe_body,
)
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.examples import read_example, read_example_data
from climbplan.simulation.conditions import NOMINAL, Conditions

ROUND = ["task.rounds=1", "task.goal.com=[0,0,0.12]"]


def planned(name: str, folder: Path, urdf: Callable[[str], str] = lambda text: text) -> ClimbPlan:
    (folder / "climb.yaml").write_text(read_example(name))
    for file, content in read_example_data(name).items():
        (folder / file).write_bytes(content)
        if file.endswith(".urdf"):
            (folder / file).write_text(urdf(content.decode()))
    return plan_climb(load_climb(folder / "climb.yaml", ROUND))


def ankles_that_mimic_knees(text: str) -> str:
    """The walker with each ankle geared to its knee."""
    return re.sub(
        r'(<joint name="(\w+)_ankle".*?)(</joint>)',
        r'\1<mimic joint="\2_knee" multiplier="-0.5" offset="0.1"/>\3',
        text,
        flags=re.DOTALL,
    )


WALKER = pytest.param("climb_walker", marks=pytest.mark.slow)


@pytest.fixture(scope="module", name="plan", params=["climb_telescope", WALKER])
def _plan(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    return planned(request.param, tmp_path_factory.mktemp("climb"), ankles_that_mimic_knees)


@pytest.fixture(scope="module", name="stored")
def _stored(plan: ClimbPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stored") / "plan.h5"
    write_climb(plan, path)
    return path


def test_plans_are_verified_from_the_file_alone(plan: ClimbPlan, stored: Path) -> None:
    verification = verify_plan(read_as_found(stored))
    assert verification.passed, verification.failed
    chain = read_climb(stored).robot.mechanism
    assert isinstance(chain, SerialChain)
    assert isinstance(plan.robot.mechanism, SerialChain)
    np.testing.assert_array_equal(chain.slides_zero, plan.robot.mechanism.slides_zero)
    np.testing.assert_array_equal(chain.drives, plan.robot.mechanism.drives)
    bounds = next(c for c in verification.checks if c.name == "kinematics.joint_bounds")
    assert re.fullmatch(r"[\d.]+ (deg|mm)", bounds.margin)


@pytest.mark.parametrize(
    ("name", "number", "check"),
    [
        ("robot/chain/slide_zero", (0, 2, 0), None),
        ("robot/chain/drive", (0, 3, 2), "robot.spec"),
        ("instants/joint_angles", (0, 0, 2), "kinematics.forward"),
        ("instants/joint_torques", (1, 1, 2), "torque.from_forces"),
        ("robot/joint_stiffness", (0, 2), "stiffness.force_deflection"),
    ],
)
def test_changed_numbers_are_found(
    stored: Path, tmp_path: Path, name: str, number: tuple[int, ...], check: str | None
) -> None:
    path = tmp_path / "plan.h5"
    path.write_bytes(stored.read_bytes())
    with h5py.File(path, "r+") as file:
        if name not in file:
            pytest.skip(f"no {name} in plans of this robot")
        file[name][number] *= 1.02
    if check is None:
        with pytest.raises(PlanFileError, match="slides along a unit"):
            read_as_found(path)
        return
    assert check in [found.name for found in verify_plan(read_as_found(path)).failed]


def test_the_model_is_the_robot(plan: ClimbPlan) -> None:
    robot = plan.robot
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, Conditions(backlash=0.01)))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    names = [name for limb in range(4) for name in name_motors(robot, limb)]
    address = [model.joint(name).qposadr[0] for name in names]
    kinds = np.array([model.joint(name).type[0] for name in names]).reshape(robot.slides.shape)
    assert ((kinds == mujoco.mjtJoint.mjJNT_SLIDE) == robot.slides).all()
    chains = build_chains(build_regulator_tables(plan))
    for _ in range(5):
        angles = rng.uniform(robot.joint_lower, robot.joint_upper) * robot.has_joint
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        data.qpos[address] = (compute_drive(robot) @ angles[..., None]).ravel()
        mujoco.mj_kinematics(model, data)
        toes = np.array([data.geom(f"toe{limb}").xpos for limb in range(4)])
        np.testing.assert_allclose(toes, toe_body(robot, angles), atol=1e-9)
        np.testing.assert_allclose(chains.place(angles), toes, atol=1e-9)


def test_weights_of_links_by_virtual_work(plan: ClimbPlan) -> None:
    """Torques and forces are the slope of the links' potential energy by the angles."""
    robot, conditions = plan.robot, Conditions(limb_mass_share=0.3)
    found = compute_gravity_torques(plan, conditions)[0]
    rotation = rotation_world_body(plan.instants.rpy[0])
    weight = compute_link_mass(robot, conditions) * robot.gravity
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)

    def energy(angles: np.ndarray) -> float:
        begin, end = chain.pose(angles).places, joint_points_body(robot, angles)[:, 1:]
        return float(weight * ((begin + end) / 2 @ rotation.T)[..., 2].sum())

    rounds, step = plan.rounds, 1e-6
    angles = solve_inverse_kinematics(
        robot, to_body(rounds.com[0], rounds.rpy[0], rounds.toes[0])
    ).best()
    for limb in range(4):
        for joint in range(robot.joint_count):
            more, less = angles.copy(), angles.copy()
            more[limb, joint] += step
            less[limb, joint] -= step
            slope = (energy(more) - energy(less)) / (2 * step)
            assert found[limb, joint] == pytest.approx(slope, abs=1e-5)


def test_exported_motions_are_in_balance_on_the_urdf(plan: ClimbPlan, stored: Path) -> None:
    """As of the walker, with joints that slide or that mimic others."""
    motion = climb_motion(stored)
    samples = np.arange(0, len(motion.time), 20)
    toe, torque, wrench = Played(motion, plan.robot_texts.urdf).statics(samples)
    assert toe < 1e-6
    assert torque < 1e-3
    assert wrench < 1e-2


def test_units_are_told(plan: ClimbPlan, stored: Path, tmp_path: Path) -> None:
    export_csv(stored, tmp_path / "motion.csv")
    header = (tmp_path / "motion.csv").read_text().splitlines()[0]
    motion = climb_motion(stored)
    assert motion.joints is not None
    if not plan.robot.slides.any():
        assert "ankle" not in header  # what mimics another joint is told nothing
        assert len(motion.joints.names) == 12
        return
    assert "L1_lift_rad,L1_extend_m" in header
    assert "150 N m/rad and 8000 N/m" in motion.words[0]
    with pytest.raises(UsageError, match="joints that slide"):
        read_gains("150", motion.joints.names, motion.joints.slides)
    strong = np.where(plan.robot.slides, plan.robot.max_torque, 1e6)
    forces = replace(plan.forces, safety_torque=plan.forces.safety_torque)
    told = describe_min_safety(
        replace(plan, robot=replace(plan.robot, max_torque=strong), forces=forces)
    )
    assert re.search(r"_extend [\d.]+ N$", told)


@pytest.mark.slow
@pytest.mark.parametrize("regulator", ["nothing", "joints"])
def test_climbs_stand_in_simulation(plan: ClimbPlan, regulator: str) -> None:
    conditions = replace(NOMINAL, regulator=regulator)
    run = simulate(plan, conditions)
    assert not run.fallen
    assert np.linalg.norm(run.com[-1] - plan.trajectory.com[-1]) < 0.01
    if find_mimic_joints(plan.robot).any():
        with pytest.raises(UsageError, match="mimic others"):
            prepare_steps(plan, conditions)
        return
    steps = prepare_steps(plan, conditions)
    path = np.zeros((len(steps.sample), 3 + 6 * 4))
    assert not simulate_steps(plan, steps, conditions, path)[HAS_FALLEN]
    off = np.linalg.norm(path[:, :3] - run.com[steps.sample], axis=1)
    assert np.median(off) < 2e-3
