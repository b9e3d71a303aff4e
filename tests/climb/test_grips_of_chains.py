"""Grippers at the toes of a robot from a URDF: wrists count from the last link of a chain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker

from climbplan.climb.check.anew.kinematics import build_limbs
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.forces.grips.moment_distribution import distribute_moment
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.plan.grips import GripForces
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.mechanics.grip import Grippers, grip_cones, split_into_parts
from climbplan.mechanics.gripper_model import load_model
from climbplan.robots.any_robot import build_robot
from climbplan.robots.gripper import Gripper
from climbplan.robots.kinematics import toe_body
from climbplan.robots.last_link import joint_axes_body, last_link_body
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_any_robot
from climbplan.verification.check import GRIP_LIMITS

SPECS = Path(__file__).parents[2] / "specs"
FORE_AND_AFT = {"forward": (0.14425, -0.14425), "sprawl_deg": (90.0, -90.0), "half_width": 0.1355}
TOES = {"L1": (-0.18, 0.307), "R1": (0.18, 0.307), "L2": (-0.18, -0.307), "R2": (0.18, -0.307)}
ROBOT = """kind: robot
urdf: hanger.urdf
joint_stiffness: 100
gripper:
  {length: 0.0995, finger_span: 0.05, max_force: 80, wrist_max_torque: [4.1, 4.1, 4.1],
   wrist_lower_deg: [-60, -80, -95], wrist_upper_deg: [60, 80, 95]}
legs:
"""


def written(folder: Path, joints: int = 3, text: str = "") -> Path:
    """A robot that hangs on four grippers, and its climb up one wall."""
    body = Walker(**FORE_AND_AFT, joints=joints, effort=30.0, body_mass=3.0, link_mass=0.1)
    (folder / "hanger.urdf").write_text(text or body.text(), encoding="utf-8")
    legs = [
        f"  {leg}: {{toe: {leg}_toe, stance: [{x}, {y}, -0.26]}}" for leg, (x, y) in TOES.items()
    ]
    (folder / "hanger.yaml").write_text(ROBOT + "\n".join(legs) + "\n")
    climb = (
        (SPECS / "climb_single_wall.yaml")
        .read_text()
        .replace("robot: scaler", "robot: hanger.yaml")
    )
    before, _, rest = climb.partition("  stance:\n")
    (folder / "hang.yaml").write_text(
        f"{before}  gait: [L1, R2, R1, L2]\n\ngripper:{rest.partition('gripper:')[2]}"
    )
    return folder / "hang.yaml"


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("hanger")
    written(folder)
    return build_robot(load_any_robot(folder / "hanger.yaml"))


def test_the_last_link_turns_with_the_joints(robot: Robot) -> None:
    """As differences of its rows say, and as the checker builds it from where joints are."""
    assert robot.gripper is not None
    share = np.random.default_rng(0).random((5, robot.limb_count, robot.joint_count))
    angles = robot.joint_lower + share * (robot.joint_upper - robot.joint_lower)
    link, rows = last_link_body(robot, angles), joint_axes_body(robot, angles)
    np.testing.assert_allclose(
        link @ np.swapaxes(link, -1, -2), np.broadcast_to(np.eye(3), link.shape), atol=1e-12
    )
    tip = toe_body(robot, angles) - robot.limbs.joint_points(angles)[..., -2, :]
    assert ((link[..., 0, :] * tip).sum(axis=-1) > 0).all()
    for joint in range(robot.joint_count):
        step = np.zeros(robot.joint_count)
        step[joint] = 1e-6
        change = (
            last_link_body(robot, angles + step) - last_link_body(robot, angles - step)
        ) / 2e-6
        np.testing.assert_allclose(change, np.cross(rows[..., joint, None, :], link), atol=1e-8)
    still = np.zeros((5, 3)), np.broadcast_to(np.eye(3), (5, 3, 3))
    np.testing.assert_allclose(
        build_limbs(robot, *still, angles).compute_link_frame(), link, atol=1e-12
    )


def test_legs_that_no_wrist_fits_are_refused(tmp_path: Path) -> None:
    spec = written(tmp_path, joints=4)
    with pytest.raises(SpecError, match=r"legs\.L1\.toe: a leg with a gripper has 3 joints below"):
        load_climb(spec)
    text = Walker(**FORE_AND_AFT).text().replace('xyz="0 0 -0.375"', 'xyz="0 0.2 0"')
    written(tmp_path, text=text)
    with pytest.raises(SpecError, match=r"lies on the axis of its last joint"):
        build_robot(load_any_robot(tmp_path / "hanger.yaml"))


def test_methods_that_know_no_grippers_say_so(tmp_path: Path) -> None:
    spec = written(tmp_path)
    with pytest.raises(SpecError, match="grippers, whose postures only `micp` plans"):
        load_climb(spec, ["solver.method=nlp"])


@pytest.mark.slow
def test_a_robot_from_a_urdf_hangs_on_its_grippers(tmp_path: Path) -> None:
    spec = written(tmp_path)
    plan = plan_climb(load_climb(spec, ["task.rounds=1", "task.goal.com=[0,-0.3595,0.075]"]))
    write_climb(plan, tmp_path / "plan.h5")
    verification = verify_plan(read_climb(tmp_path / "plan.h5"))
    assert verification.passed, verification.table()
    assert set(GRIP_LIMITS) <= {check.name for check in verification.checks}
    assert plan.grips is not None
    front = [plan.robot.limb_names.index(leg) for leg in ("L1", "R1")]
    onto = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    assert (onto[:, front] < 0).any()  # someone above pulls


def test_a_missing_moment_is_shared_by_parts_that_press() -> None:
    """Balance, and nothing but what presses already: not idle fingers, not limbs in the air."""
    rng = np.random.default_rng(3)
    gripper = Gripper(0.1, 0.05, 80.0, np.full(3, 4.0), np.full(3, -1.0), np.full(3, 1.0))
    up = np.array([0.0, 0.0, 1.0])
    undercut = np.deg2rad([0.0, 20.0, -90.0])
    grippers = Grippers(
        gripper=gripper,
        model=load_model("spine_synthetic"),
        risk=0.05,
        axis=np.tile([1.0, 0.0, 0.0], (3, 1)),
        undercut=undercut,
        orientation=np.zeros((3, 3)),
        friction=np.full(3, 0.5),
        spines=np.full(3, 4.0),
    )
    region, contact = np.array([[0, 1, 2, 0]]), np.array([[True, True, True, False]])
    normal = np.broadcast_to(up, (1, 4, 3))
    arms = rng.normal(size=(1, 4, 3)) * 0.3
    force = np.where(contact[..., None], rng.normal(size=(1, 4, 3)) + 5 * up, 0.0)
    # The first gripper stands on its palm alone, the others hold with palm and fingers
    grip = np.array([[0.0, 9.0, 1.0, 0.0]])
    palm = np.where(np.arange(4)[:, None] == 0, force, force / 3)
    grips = GripForces(grip, palm, np.zeros((1, 4, 3)))
    off = np.array([[0.02, -0.03, 0.04]])
    more, shared = distribute_moment(
        grippers,
        normal,
        region,
        contact,
        arms=arms,
        force=force,
        grips=grips,
        missing_moment=off,
        in_line=1e-6,
    )
    change = more - force
    moment = np.cross(arms, change) + shared.moment
    np.testing.assert_allclose(change.sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(moment.sum(axis=1), off, atol=1e-12)
    assert not change[0, 3].any()
    assert not shared.packed_array[0, 3].any()
    axis = grippers.axis[region]
    parts = split_into_parts(
        more, shared.grip, shared.moment, shared.palm, axis, gripper.finger_span
    )
    cones = grip_cones(normal, axis, undercut[region], np.full((1, 4), 0.5), np.full((1, 4), 4.0))
    assert cones.pressure(parts).min() > -1e-12
    assert cones.excess(parts, 1.0).max() < 1e-12
