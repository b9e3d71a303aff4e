"""Walks as exported: momentum of held forces, toes that stand still, feet on the floor, joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_statics import Played
from walking_urdf import WALK, write_robot

from climbplan.exports.formats import ControllerOptions, adapt_motion
from climbplan.exports.motion import ExportedJoints, RobotMotion
from climbplan.exports.sidecar import collect_facts
from climbplan.walking.check.verification import verify
from climbplan.walking.exports.motion import NO_JOINTS
from climbplan.walking.exports.motion import read_motion as walk_motion
from climbplan.walking.plan.file import read_walk_plan, write_walk_plan
from climbplan.walking.plan.foot_centres import raise_task, restore_surface, shift_to_foot_centres
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc
from climbplan.walking.task.ground import Ground
from climbplan.walking.task.task import VELOCITY

pytest.importorskip("pinocchio")
FOOT = 0.02  # [m]


@pytest.fixture(scope="module", name="walk")
def _walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot with spherical feet walks on flat ground."""
    folder = tmp_path_factory.mktemp("walk")
    write_robot(folder, more=f"foot: {{radius: {FOOT}}}")
    (folder / "walk.yaml").write_text(WALK, encoding="utf-8")
    write_walk_plan(plan_walk(load_mpc(folder / "walk.yaml")), folder / "plan.h5")
    return folder / "plan.h5"


def joints(motion: RobotMotion) -> ExportedJoints:
    assert motion.joints is not None
    return motion.joints


def impulse_off(motion: RobotMotion, plan: WalkPlan) -> float:
    """What forces and weight add up to beside the change of momentum, of the weight's impulse."""
    body, state = plan.task.body, plan.trajectory.state
    assert motion.contacts is not None
    span = np.diff(motion.time)
    given = (motion.contacts.force[:-1].sum(axis=1) * span[:, None]).sum(axis=0)
    weight = body.mass * body.gravity * span.sum()
    given = given - np.array([0.0, 0.0, weight])
    gained = body.mass * (state[-1, VELOCITY] - state[0, VELOCITY])
    return float(np.abs(given - gained).max() / weight)


@pytest.mark.parametrize("rate", [None, 77.0, 100.0, 500.0])
def test_held_forces_add_up_to_the_change_of_momentum(
    walk: Path, plans: dict[str, Path], rate: float | None
) -> None:
    """Where samples do not meet changes of force there are more of them."""
    for path in (walk, plans["walk"]):
        motion = adapt_motion(walk_motion(path), ControllerOptions(rate=rate))
        assert impulse_off(motion, read_walk_plan(path)) < 1e-9
        assert not motion.words or motion.words == (NO_JOINTS,)
        if rate is not None:
            assert np.diff(motion.time).max() < 1 / rate + 1e-9
            extra = len(motion.time) - 1 - motion.time[-1] * rate
            assert extra < 1 if rate > 77 else extra < read_walk_plan(path).task.knots + 1


def test_rates_too_slow_for_changes_of_force_are_told(plans: dict[str, Path]) -> None:
    plan = read_walk_plan(plans["walk"])
    slow = adapt_motion(walk_motion(plans["walk"]), ControllerOptions(rate=0.7 / plan.task.dt))
    assert any("forces change every" in word for word in slow.words)


def test_toes_stand_still_on_the_floor_until_they_lift(walk: Path) -> None:
    plan, motion = (
        read_walk_plan(walk),
        adapt_motion(walk_motion(walk), ControllerOptions(rate=500.0)),
    )
    contacts = motion.contacts
    assert contacts is not None
    stays = contacts.touching[1:] & contacts.touching[:-1]
    assert (np.diff(contacts.point, axis=0)[stays] == 0.0).all()
    assert np.abs(contacts.point[contacts.touching][:, 2]).max() < 1e-4
    assert (contacts.force[~contacts.touching] == 0.0).all()
    swinging = contacts.point[..., 2][~contacts.touching]
    assert swinging.min() > -1e-12
    assert swinging.max() == pytest.approx(plan.task.swing_clearance, abs=1e-4)


def test_joints_put_feet_where_the_plan_has_them(walk: Path) -> None:
    plan, motion = (
        read_walk_plan(walk),
        adapt_motion(walk_motion(walk), ControllerOptions(rate=250.0)),
    )
    played, contacts = Played(motion, plan.robot_urdf), motion.contacts
    assert contacts is not None
    import pinocchio as pin

    for k in range(0, len(motion.time), 7):
        q = played.configuration(k, joints(motion).angle)
        pin.framesForwardKinematics(played.model, played.data, q)
        for c, contact in enumerate(collect_facts(motion)["contacts"]):  # type: ignore[arg-type]
            _, toe = played.toe(contact)
            assert toe == pytest.approx(contacts.point[k, c] + [0, 0, FOOT], abs=1e-6)


def test_velocities_accelerations_and_torques_are_those_of_the_motion(walk: Path) -> None:
    motion = adapt_motion(walk_motion(walk), ControllerOptions(rate=1000.0))
    own = joints(motion)
    moved = (own.angle[2:] - own.angle[:-2]) / 2e-3
    off = np.abs(moved - own.velocity[1:-1])
    assert np.median(off) < 1e-3
    faster = (own.velocity[2:] - own.velocity[:-2]) / 2e-3
    scale = np.abs(own.acceleration).max()
    assert np.median(np.abs(faster - own.acceleration[1:-1])) < 1e-3 * scale
    assert np.array_equal(own.feedforward, own.torque)
    stiff = joints(
        adapt_motion(walk_motion(walk), ControllerOptions(rate=1000.0, gains="80", gravity=True))
    )
    assert (stiff.gain == 80.0).all()
    assert np.array_equal(stiff.command, own.command)
    assert stiff.effort == pytest.approx(own.torque + own.gravity)


def test_plans_with_centres_of_feet_on_the_ground_verify_and_are_raised(
    walk: Path, tmp_path: Path
) -> None:
    plan = read_walk_plan(walk)
    assert plan.task.ground.standoff == FOOT
    assert verify(walk).passed
    lower = raise_task(plan.task, -FOOT)
    found = plan.trajectory
    state, toes = found.state.copy(), found.toes.copy()
    state[:, 2] -= FOOT
    toes[..., 2] -= FOOT
    before = replace(
        plan,
        task=replace(lower, ground=replace(lower.ground, standoff=0.0)),
        trajectory=replace(found, state=state, toes=toes),
    )
    write_walk_plan(before, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed
    now, then = walk_motion(walk), walk_motion(tmp_path / "plan.h5")
    assert then.bodies[0].position == pytest.approx(now.bodies[0].position, abs=1e-12)
    assert any("raised by their radius" in word for word in then.words)
    # A file that says so of a robot with other feet is found out
    other = replace(plan, task=replace(plan.task, ground=replace(plan.task.ground, standoff=0.01)))
    write_walk_plan(other, tmp_path / "other.h5")
    assert not verify(tmp_path / "other.h5").passed


def test_spheres_touch_planes_that_slope() -> None:
    sides = np.array([[0.0, 0.0]]), np.array([[1.0, 1.0]])
    level = Ground.level(("ramp",), *sides, np.array([0.1]), 0.8)
    ramp = replace(level, slope=np.array([[0.3, -0.2]]))
    centres = shift_to_foot_centres(ramp, FOOT)
    planes = replace(centres, height=centres.height + FOOT)
    xy, region = np.array([0.4, 0.7]), np.array(0)
    centre = np.append(xy, planes.compute_height(region, xy))
    below = np.append(xy, ramp.compute_height(region, xy))
    away = (centre - below) @ ramp.frame[0, 2]
    assert away == pytest.approx(FOOT, abs=1e-12)
    assert restore_surface(planes).height == pytest.approx(ramp.height, abs=1e-12)


def test_robots_without_links_have_no_joints(plans: dict[str, Path]) -> None:
    motion = walk_motion(plans["walk"])
    assert motion.joints is None
    assert motion.base is None
    assert motion.words == (NO_JOINTS,)
