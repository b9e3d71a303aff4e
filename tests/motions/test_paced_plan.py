"""Plans that are timed by the dynamics of their links: their loads move the links, and hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from short_climb import SHORT_CLIMB

from climbplan.arrays import Array
from climbplan.climb.check.anew.inertia import compute_inertia
from climbplan.climb.check.anew.kinematics import compute_body_axes
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.exports.tracked_motion import build_tracked_motion
from climbplan.climb.motion import retiming
from climbplan.climb.plan.climb_plan import ClimbPlan, Trajectory
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb, load_text
from climbplan.errors import SpecError, Unresolved, UsageError
from climbplan.mechanics.inertia import CarriedMass, compute_inertial_load
from climbplan.motions.completion import read_robot
from climbplan.motions.measure import measure_motion
from climbplan.motions.pace import build_pyramids
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import toe_world
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot

SPECS = Path(__file__).parents[2] / "specs"
SHORT = ["task.rounds=1", "task.goal.com=[0,0,0.02]", "trajectory.pace=fastest"]
NOTHING = CarriedMass(0.0, np.zeros(3))


@pytest.fixture(scope="module")
def paced_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plan file of a climb by a robot from a URDF, as fast as its dynamics allow."""
    pytest.importorskip("pinocchio")
    path = tmp_path_factory.mktemp("paced_climb") / "plan.h5"
    write_climb(plan_climb(load_climb(SPECS / "climb_walker.yaml", SHORT)), path)
    return path


@pytest.fixture(scope="module")
def paced(paced_file: Path) -> ClimbPlan:
    """The plan in that file."""
    return read_climb(paced_file)


def list_failures(plan: ClimbPlan) -> set[str]:
    return {check.name for check in verify_plan(plan).checks if not check.passed}


def test_a_paced_plan_is_faster_and_keeps_all_limits(paced: ClimbPlan, urdf_climb: Path) -> None:
    slow, fast = read_climb(urdf_climb).trajectory, paced.trajectory
    assert fast.time[-1] < slow.time[-1] / 1.2
    checks = {check.name: check for check in verify_plan(paced).checks}
    assert all(check.passed for check in checks.values())
    assert checks["trajectory.dynamics"].residual < 1e-9
    assert fast.torque is not None
    assert (np.abs(fast.torque) <= paced.robot.max_torque * (1 + 1e-6)).all()
    assert "trajectory.dynamics" not in {c.name for c in verify_plan(read_climb(urdf_climb)).checks}


def test_toes_land_slowly(paced: ClimbPlan) -> None:
    """The last way to the surface, from rest to rest, is no faster than 0.2 m/s."""
    moved, contact = paced.trajectory, paced.trajectory.contact
    toes = toe_world(paced.robot, moved.com, moved.rpy, moved.joint_command)
    speed = np.linalg.norm(np.diff(toes, axis=0), axis=-1) / np.diff(moved.time)[:, None]
    landings = np.argwhere(contact[1:] & ~contact[:-1])
    assert len(landings) == paced.robot.limb_count
    peaks = []
    for sample, limb in landings:
        before = speed[: sample - 1, limb][::-1]
        rest = int(np.argmax((before < 1e-3) & (before.cumsum() > 0.1)))
        peaks.append(before[:rest].max())
    assert 0.1 < max(peaks) <= 0.2 * 1.05


def change_one(name: str, factor: float) -> Callable[[Trajectory], Trajectory]:
    def change(trajectory: Trajectory) -> Trajectory:
        values = getattr(trajectory, name).copy()
        values[len(values) // 2] *= factor
        return replace(trajectory, **{name: values})

    return change


@pytest.mark.parametrize(
    ("change", "failures"),
    [
        (change_one("force", 1 + 1e-4), {"trajectory.dynamics"}),
        (change_one("torque", 1 + 1e-3), {"trajectory.dynamics"}),
        (change_one("joint_command", 1 + 1e-3), {"trajectory.command"}),
        (lambda t: replace(t, time=0.8 * t.time), {"trajectory.dynamics", "trajectory.command"}),
        (lambda t: replace(t, torque=None, force=None), {"trajectory.dynamics"}),
    ],
)
def test_loads_that_do_not_move_the_links_are_found(
    paced: ClimbPlan, change: Callable[[Trajectory], Trajectory], failures: set[str]
) -> None:
    assert list_failures(replace(paced, trajectory=change(paced.trajectory))) >= failures


def test_a_factor_is_kept_where_limits_allow_it(urdf_climb: Path) -> None:
    changes = [*SHORT[:2], "trajectory.pace=0.5"]
    half = plan_climb(load_climb(SPECS / "climb_walker.yaml", changes)).trajectory
    slow = read_climb(urdf_climb).trajectory
    assert half.is_paced
    assert half.time[-1] / slow.time[-1] == pytest.approx(2, rel=0.1)


def test_its_exported_motion_is_in_balance(paced: ClimbPlan) -> None:
    motion = build_tracked_motion(paced, 200.0)
    robot = read_robot(SPECS / "walker.urdf")
    checks = {c.name: c for c in measure_motion(motion, {}, robot)}
    assert all(check.passed for check in checks.values())
    # Between samples the motion is smoother than their second differences
    assert checks["dynamics.balance"].residual < 0.05
    assert checks["dynamics.stored_torque"].residual < 0.05
    static = replace(paced, trajectory=replace(paced.trajectory, force=None, torque=None))
    without = measure_motion(build_tracked_motion(static, 200.0), {}, robot)
    stored = {c.name: c.residual for c in without}["dynamics.stored_torque"]
    assert checks["dynamics.stored_torque"].residual < stored


def test_quasi_static_steps_refuse_it(paced: ClimbPlan) -> None:
    from climbplan.climb.simulation.implicit_dynamics.engine import prepare_steps
    from climbplan.simulation.conditions import NOMINAL

    with pytest.raises(UsageError, match=r"inertia \(trajectory.pace\), which the statics engine"):
        prepare_steps(paced, NOMINAL)


@pytest.mark.merge
def test_it_stands_in_mujoco_without_a_slip(paced: ClimbPlan) -> None:
    pytest.importorskip("mujoco")
    from climbplan.climb.simulation.comparison import find_losses, find_slips
    from climbplan.climb.simulation.replay import simulate
    from climbplan.simulation.conditions import NOMINAL

    run = simulate(paced, NOMINAL)
    assert not run.fallen
    assert not find_slips(paced, run)
    assert not find_losses(paced, run)
    assert np.linalg.norm(run.com - paced.trajectory.com, axis=1).max() < 0.01


def test_flat_feet_and_bodies_without_link_masses_are_timed_too() -> None:
    biped = ["task.rounds=1", "task.goal.com=[0,0.1,0.52]", "trajectory.pace=fastest"]
    plan = plan_climb(load_climb(SPECS / "climb_biped.yaml", biped))
    assert plan.trajectory.moment is not None
    assert not list_failures(plan)
    massless = plan_climb(load_text(SHORT_CLIMB, "short", ["trajectory.pace=fastest"]))
    assert massless.trajectory.is_paced
    assert not list_failures(massless)


@pytest.mark.parametrize("pace", ["swift", "0", "-1", "2000", "true"])
def test_paces_that_cannot_be(pace: str) -> None:
    with pytest.raises(SpecError, match=r"trajectory\.pace"):
        load_climb(SPECS / "climb_walker.yaml", [f"trajectory.pace={pace}"])


def test_grippers_have_no_pace() -> None:
    with pytest.raises(SpecError, match="has grippers"):
        plan_climb(load_climb(SPECS / "climb_ceiling.yaml", ["trajectory.pace=2"]))


def sample_motion(robot: Robot, period: float) -> tuple[Array, Array, Array]:
    """Return positions, angles of the body and joint angles of a smooth motion at samples."""
    rng = np.random.default_rng(5)
    time = period * np.arange(-2, 3)
    middle = (robot.joint_lower + robot.joint_upper) / 2
    waves = [np.sin(3 * time + phase) for phase in rng.uniform(0, 6, 6 + middle.size)]
    body = 0.3 * np.stack(waves[:6], axis=1)
    angles = 0.3 * np.stack(waves[6:], axis=1).reshape(len(time), *middle.shape)
    return body[:, :3], body[:, 3:], np.where(robot.has_joint, middle + angles, 0.0)


@pytest.mark.parametrize("name", ["robot_walker", "robot_biped", "robot_telescope"])
def test_inertia_is_pinocchios(name: str) -> None:
    """The dynamics of all links by the recursive Newton-Euler algorithm, in planning and checks."""
    pin = pytest.importorskip("pinocchio")
    from climbplan.robots.urdf.pinocchio_model import build_urdf_model

    given = load_any_robot(SPECS / f"{name}.yaml")
    assert isinstance(given, UrdfRobot)
    robot, urdf = build_robot(given), build_urdf_model(given)
    period = 1e-3
    com, rpy, angles = sample_motion(robot, period)
    load = compute_inertial_load(robot, com, rpy, angles, period=period, carried=NOTHING)
    anew = compute_inertia(
        robot, com, compute_body_axes(rpy), angles, step=period, payload=(0.0, np.zeros(3))
    )
    np.testing.assert_allclose(anew.wrench, load.wrench, atol=1e-6)
    np.testing.assert_allclose(anew.torque, load.torque, atol=1e-6)
    # The same body in Pinocchio: a free joint at the root, whose frame may differ
    from climbplan.exports.base_link import build_base_link

    assert isinstance(robot.mechanism, SerialChain)
    base = build_base_link(given, robot.mechanism, np.eye(3))
    rotation = rotation_world_body(rpy) @ base.rotation
    origin = com + rotation_world_body(rpy) @ base.position
    free = urdf.model
    names = [n for limb in robot.limbs.joint_names for n in limb if n]

    def configure(k: int) -> Array:
        row = dict(zip(names, angles[k][robot.has_joint], strict=True))
        q = urdf.build_configuration(row)
        q[:3] = origin[k]
        q[3:7] = pin.Quaternion(rotation[k]).coeffs()
        return np.asarray(q)

    before, middle, after = (configure(k) for k in (1, 2, 3))
    first, second = pin.difference(free, before, middle), pin.difference(free, middle, after)
    velocity, acceleration = (first + second) / (2 * period), (second - first) / period**2
    workspace = free.createData()
    moving = pin.rnea(free, workspace, middle, velocity, acceleration)
    still = pin.rnea(free, workspace, middle, np.zeros(free.nv), np.zeros(free.nv))
    inertia = moving - still
    force = -rotation[2] @ inertia[:3]
    moment = -rotation[2] @ inertia[3:6] + np.cross(origin[2] - com[2], force)
    wrench = np.concatenate([force, moment])
    np.testing.assert_allclose(load.wrench[2], wrench, rtol=2e-3, atol=2e-3)
    torque = [inertia[free.joints[free.getJointId(n)].idx_v] for n in names]
    if name != "robot_telescope":  # where Pinocchio gives torques to joints that follow others
        np.testing.assert_allclose(-load.torque[2][robot.has_joint], torque, rtol=2e-3, atol=2e-3)


def test_a_box_and_its_load_take_force_and_moment() -> None:
    robot = build_robot(load_any_robot("silvia"))
    period, count = 0.01, 5
    time = period * np.arange(count)
    com = np.zeros((count, 3))
    com[:, 0] = time**2  # 2 m/s^2
    rpy = np.zeros((count, 3))
    rpy[:, 2] = 1.5 * time**2  # 3 rad/s^2
    angles = np.zeros((count, robot.limb_count, robot.joint_count))
    load = compute_inertial_load(
        robot, com, rpy, angles, period=period, carried=CarriedMass(2.0, np.zeros(3))
    )
    size = np.ptp(robot.body_hull, axis=0)
    inertia = robot.mass / 12 * (size[0] ** 2 + size[1] ** 2)
    expected = [-2 * (robot.mass + 2), 0, 0, 0, 0, -3 * inertia]
    np.testing.assert_allclose(load.wrench[2], expected, atol=1e-6)
    assert not load.torque.any()


def test_forces_at_their_limits_have_no_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without friction, feet between walls hold nothing; the reason is the planned forces'."""
    monkeypatch.setattr(
        retiming, "build_pyramids", lambda n, mu, f, s: build_pyramids(n, 0.0 * mu, 0.0 * f, s)
    )
    with pytest.raises(Unresolved, match="no contact forces within friction and torque limits"):
        plan_climb(load_climb(SPECS / "climb_walker.yaml", SHORT))
