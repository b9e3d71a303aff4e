"""A quadruped from a URDF climbs; its plan is verified without the URDF."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from urdf_statics import Played
from urdf_walkers import QUADRUPED

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.exports.motion import read_motion as climb_motion
from climbplan.climb.exports.regulator_files import write_regulator
from climbplan.climb.exports.table import export_csv
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_as_found, read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.planner.start_from_plan import resolve_start_plan
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.executive.replanning import MeasuredStance, replan_climb
from climbplan.errors import SpecError
from climbplan.exports.formats import ControllerOptions, adapt_motion
from climbplan.exports.sidecar import collect_facts
from climbplan.robots.kinematics import toe_world
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.examples import read_example, read_example_data
from climbplan.verification.verification import mark_verified

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "climbplan" / "robots" / "README.md"


@pytest.fixture(scope="module", name="plan")
def _plan(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    folder = tmp_path_factory.mktemp("walker")
    (folder / "climb.yaml").write_text(read_example("climb_walker"))
    for name, content in read_example_data("climb_walker").items():
        (folder / name).write_bytes(content)
    plan = plan_climb(
        load_climb(folder / "climb.yaml", ["task.rounds=1", "task.goal.com=[0,0,0.12]"])
    )
    shutil.rmtree(folder)  # nothing of it is needed again
    return plan


@pytest.fixture(scope="module", name="stored")
def _stored(plan: ClimbPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stored") / "plan.h5"
    write_climb(plan, path)
    return path


def test_the_plan_is_verified_from_its_file_alone(plan: ClimbPlan, stored: Path) -> None:
    verification = verify_plan(read_as_found(stored))
    assert verification.passed, verification.failed
    assert len(verification.checks) >= 41
    assert plan.robot.joint_count == 4
    assert any(text.startswith("assumed of walker: ") for text in plan.warnings)


def _put_mesh(urdf: str) -> str:
    """Return a URDF with a mesh for the first collision geometry."""
    start = urdf.index("<geometry>", urdf.index("<collision")) + len("<geometry>")
    end = urdf.index("</geometry>", start)
    return urdf[:start] + '<mesh filename="package://walker/trunk.stl"/>' + urdf[end:]


def test_a_climb_is_planned_anew_without_the_meshes_that_shaped_its_robot(
    plan: ClimbPlan, tmp_path: Path
) -> None:
    texts = replace(plan.robot_texts, urdf=_put_mesh(plan.robot_texts.urdf))
    with_mesh = replace(plan, robot_texts=texts)
    rounds = plan.rounds
    toes = rounds.toes[0].copy()
    toes[2, 2] -= 0.02
    stance = MeasuredStance(
        com=rounds.com[0],
        rotation=rotation_world_body(rounds.rpy[0]),
        toes=toes,
        friction=np.ones(len(plan.terrain.surfaces)),
        load=np.zeros(6),
        instant=0,
        next_instant=0,
    )
    write_climb(replan_climb(with_mesh, stance), tmp_path / "replanned.h5")
    replanned = read_climb(tmp_path / "replanned.h5")
    verification = verify_plan(replanned)
    assert verification.passed, verification.failed
    np.testing.assert_allclose(replanned.rounds.toes[0], toes, atol=1e-9)
    for name in ("limb_radius", "body_hull", "touching"):
        np.testing.assert_array_equal(getattr(replanned.robot, name), getattr(plan.robot, name))
    (robot_check,) = (check for check in verification.checks if check.name == "robot.spec")
    assert "from meshes, which the plan does not carry" in robot_check.margin


def test_the_file_holds_the_chains(plan: ClimbPlan, stored: Path) -> None:
    robot = read_climb(stored).robot
    own, chain = plan.robot.mechanism, robot.mechanism
    assert isinstance(own, SerialChain)
    assert isinstance(chain, SerialChain)
    assert chain.names == own.names
    for name in ("joint_zero", "axis_zero", "toe_zero", "posture"):
        np.testing.assert_array_equal(vars(chain)[name], vars(own)[name])
    instants = plan.instants
    toes = toe_world(robot, instants.com, instants.rpy, instants.joint_angles)
    np.testing.assert_allclose(toes, instants.toes, atol=1e-9)


def test_export_names_the_joints_of_the_urdf(stored: Path, tmp_path: Path) -> None:
    export_csv(stored, tmp_path / "motion.csv")
    header, first = (tmp_path / "motion.csv").read_text().splitlines()[:2]
    assert "L1_yaw_rad,L1_lift_rad,L1_knee_rad,L1_ankle_rad,R1_yaw_rad" in header
    assert len(header.split(",")) == len(first.split(",")) == 1 + 6 + 16 + 4 + 7 + 16 + 16 + 12


def test_exported_motions_are_in_balance_on_the_urdf(plan: ClimbPlan, stored: Path) -> None:
    """Root link, joint angles, torques, weights and forces, by Pinocchio on the URDF alone."""
    motion = climb_motion(stored)
    samples = np.arange(0, len(motion.time), 20)
    toe, torque, wrench = Played(motion, plan.robot_texts.urdf).statics(samples)
    assert toe < 1e-6
    assert torque < 1e-3
    assert wrench < 1e-2
    joints = motion.joints
    assert joints is not None
    assert np.abs(joints.gravity).max() > 0.5


def test_gains_of_rigid_simulators(stored: Path) -> None:
    """The same commands, on angles without the structure's give, under gains K (1 - share)."""
    planned, rigid = (
        climb_motion(stored),
        adapt_motion(climb_motion(stored), ControllerOptions(gains="rigid")),
    )
    own, joints = planned.joints, rigid.joints
    assert own is not None
    assert joints is not None
    share = collect_facts(planned)["structural_compliance_share"]
    assert share == 0.3
    assert joints.gain == pytest.approx(own.gain * (1 - 0.3))
    assert joints.command == pytest.approx(own.command, abs=1e-12)
    assert joints.gain * (joints.command - joints.angle) == pytest.approx(own.torque, abs=1e-9)
    assert own.gain * (own.command - own.angle) == pytest.approx(own.torque, abs=1e-9)
    assert "do not bend" in rigid.words[0]


def test_the_regulator_of_a_rigid_simulator(stored: Path, tmp_path: Path) -> None:
    write_regulator(stored, "rigid", tmp_path)
    with np.load(tmp_path / "regulator.npz", allow_pickle=False) as tables:
        assert tables["compliance_ratio"] == pytest.approx(1.0)  # encoders see all that gives
        planned = climb_motion(stored)
        assert planned.base is not None
        assert planned.joints is not None
        assert np.array_equal(tables["base_position"], planned.base.position)
        there = tables["joint_names"] != ""
        assert np.array_equal(tables["gravity"][:, there], planned.joints.gravity)
        bent = (tables["command"] + tables["deflection"])[:, there]
        torque = tables["gain"][there] * (tables["command"][:, there] - bent)
        assert torque == pytest.approx(planned.joints.torque, abs=1e-9)


def shifted(file: h5py.File) -> None:
    file["robot/chain/joint_zero"][0, 2, 0] += 1e-3


def turned(file: h5py.File) -> None:
    file["robot/chain/axis_zero"][1, 3] = [0.0, 0.0, 1.0]


def pressed(file: h5py.File) -> None:
    file["instants/joint_command"][0, 1, 3] += 5e-3


def bent(file: h5py.File) -> None:
    """Along the free motion: the toe stays, the springs are not at rest."""
    angles, commands = file["instants/joint_angles"], file["instants/joint_command"]
    there = file["instants/contact"][1]
    limb = int(np.flatnonzero(there)[0])
    chain = SerialChain(
        (("a", "b", "c", "d"),),
        file["robot/chain/joint_zero"][limb : limb + 1],
        file["robot/chain/axis_zero"][limb : limb + 1],
        file["robot/chain/toe_zero"][limb : limb + 1],
        np.zeros((1, 4)),
    )
    jacobian = chain.jacobian(angles[1][limb : limb + 1])[0]
    free = np.linalg.svd(jacobian)[2][3]
    commands[1, limb] = commands[1, limb] + 0.05 * free


@pytest.mark.parametrize(
    ("change", "check"),
    [
        (shifted, "robot.data"),
        (turned, "kinematics.forward"),
        (pressed, "static.pose"),
        (bent, "static.pose"),
    ],
)
def test_what_is_changed_is_found(
    stored: Path, tmp_path: Path, change: Callable[[h5py.File], None], check: str
) -> None:
    path = Path(shutil.copy(stored, tmp_path / "plan.h5"))
    with h5py.File(path, "r+") as file:
        change(file)
    failed = {found.name for found in verify_plan(read_as_found(path)).failed}
    assert check in failed


def test_the_pages_example_plans_a_robot_of_ones_own(tmp_path: Path) -> None:
    """The YAML of the page, with a URDF that has the names it uses."""
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    text = QUADRUPED.text()
    for ours, theirs in (("L1", "lf"), ("R1", "rf"), ("L2", "lh"), ("R2", "rh")):
        text = text.replace(f"{ours}_toe", f"{theirs}_foot").replace(f"{ours}_", f"{theirs}_")
    (tmp_path / "my_robot.urdf").write_text(text)
    (tmp_path / "climb.yaml").write_text(block)
    plan = plan_climb(load_climb(tmp_path / "climb.yaml"))
    write_climb(plan, tmp_path / "plan.h5")
    assert verify_plan(read_as_found(tmp_path / "plan.h5")).passed


def test_going_on_where_a_walker_stands(stored: Path, plan: ClimbPlan, tmp_path: Path) -> None:
    """Another robot with the same limbs' names and lengths is refused."""
    (tmp_path / "climb.yaml").write_text(read_example("climb_walker"))
    for name, content in read_example_data("climb_walker").items():
        (tmp_path / name).write_bytes(content)
    on = ["task.rounds=1", "task.goal.com=[0,0,0.2]", f"task.start={{plan: {stored}}}"]
    marked = Path(shutil.copy(stored, tmp_path / "verified.h5"))
    mark_verified(marked, verify_plan(read_as_found(marked)))
    on[-1] = f"task.start={{plan: {marked}}}"
    loaded = resolve_start_plan(load_climb(tmp_path / "climb.yaml", on))
    assert loaded.spec.task.start.com == tuple(plan.rounds.com[-1])
    urdf = tmp_path / "walker.urdf"
    turned_axis = urdf.read_text().replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -0.9 0.1"/>', 1)
    urdf.write_text(turned_axis)
    with pytest.raises(SpecError, match=r"a plan of walker, with an?other "):
        resolve_start_plan(load_climb(tmp_path / "climb.yaml", on))
