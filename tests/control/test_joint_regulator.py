"""The file that runs on a robot: exact, without memory taken while it ticks, alone."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.exports.regulator_files import write_regulator
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.control.regulator import (
    MIN_SINGULAR_RATIO,
    JointOdometry,
    Regulator,
    build_regulator_tables,
    compute_zero_pose,
    invert_jacobian,
)
from climbplan.climb.simulation.control.steady_rate import compute_stable_rates
from climbplan.control import joint_regulator
from climbplan.control.joint_regulator import (
    RATE,
    BodyPoseEstimate,
    Chains,
    JointRegulator,
    RegulatorTables,
)
from climbplan.robots.kinematics import toe_body
from climbplan.robots.rotations import rotation_world_body

Planned = Callable[..., ClimbPlan]


def seen(tables: RegulatorTables) -> Array:
    """(T, N, J) what encoders read where all goes as planned."""
    return np.asarray(tables.command + tables.deflection / tables.compliance_ratio)


def test_limbs_at_full_stretch_are_not_turned_through_it() -> None:
    rng = np.random.default_rng(3)
    bent = rng.normal(size=(30, 3, 4))
    bent = bent[np.linalg.cond(bent) < 1 / MIN_SINGULAR_RATIO]
    assert len(bent) > 20
    np.testing.assert_allclose(invert_jacobian(bent), np.linalg.pinv(bent), atol=1e-12)
    # Two links of 0.3 m in a plane: the knee straightens
    knee = np.concatenate([np.geomspace(0.5, 1e-6, 400), [0.0]])
    zero, one = np.zeros_like(knee), np.ones_like(knee)
    far = np.stack([0.3 * np.sin(knee), 0.3 * np.sin(knee), zero], axis=-1)
    aside = np.stack([0.3 + 0.3 * np.cos(knee), 0.3 * np.cos(knee), zero], axis=-1)
    out = np.stack([zero, zero, 0.6 * one], axis=-1)
    jacobian = np.stack([far, aside, out], axis=1)
    turn = invert_jacobian(jacobian)
    most = 1 / (MIN_SINGULAR_RATIO * np.linalg.norm(jacobian[0], ord=2))
    size = np.linalg.norm(turn, ord=2, axis=(1, 2))
    assert size.max() < 1.05 * most
    assert np.abs(np.diff(size)).max() < 0.05 * most  # without a jump
    moved = (jacobian @ turn)[:, 0, 0]
    assert moved[0] == pytest.approx(1.0)
    assert moved[-1] == pytest.approx(0.0, abs=1e-9)
    # Aside it moves as it does when it is bent
    assert (jacobian @ turn)[-1, 1, 1] == pytest.approx(1.0)


def test_chains_place_toes_where_the_robot_does(planned: Planned) -> None:
    robot = planned().robot
    zero = compute_zero_pose(robot)
    assert zero is not None
    none = np.zeros_like(zero.axes)
    alone = np.tile(np.eye(zero.axes.shape[1]), (len(zero.toe), 1, 1))
    chains = Chains(zero.axes, zero.joints, zero.toe, none, alone)
    for angles in np.random.default_rng(0).normal(size=(20, robot.limb_count, robot.joint_count)):
        np.testing.assert_allclose(chains.place(angles), toe_body(robot, angles), atol=1e-12)


def kabsch(points: Array, places: Array) -> tuple[Array, Array]:
    """The motion that carries points (n, 3) nearest to places (n, 3), by singular values."""
    middle, there = points.mean(axis=0), places.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (places - there))
    hand = np.array([1.0, 1.0, np.linalg.det(right.T @ left.T)])
    rotation = (right.T * hand) @ left.T
    return there - rotation @ middle, rotation


def test_the_pose_is_the_least_squares_one(planned: Planned) -> None:
    plan = planned()
    tables = build_regulator_tables(plan)
    pose, rng = BodyPoseEstimate(tables), np.random.default_rng(1)
    turn = rotation_world_body(np.array([0.2, -0.1, 0.3]))
    body = (tables.toes - [0.1, 0.0, 0.05]) @ turn + rng.normal(0, 5e-3, tables.toes.shape)
    pose.update(0, body)
    known = tables.trusted[0] > 0
    com, rotation = kabsch(body[known], tables.toes[known])
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-10)
    np.testing.assert_allclose(pose.com, com, atol=1e-10)


def test_it_ticks_as_simulations_do(planned: Planned) -> None:
    plan = planned()
    tables = build_regulator_tables(plan)
    np.testing.assert_allclose(tables.command, plan.trajectory.joint_command, atol=1e-12)
    angles = seen(tables) + np.random.default_rng(2).normal(0, 1e-3, tables.command.shape)
    ticking = JointRegulator(tables)
    regulator, odometry = Regulator(plan, correct_position=True), JointOdometry(plan)
    before, last = float(tables.time[0]), tables.command[0]
    for sample, moment in enumerate(tables.time.tolist()):
        lag = (angles[sample] - last) * tables.compliance_ratio
        pose = odometry.pose(sample, last + lag)
        added = regulator.compute_correction(sample, moment - before, pose, lag)
        last = tables.command[sample] + added
        before = moment
        np.testing.assert_allclose(ticking.tick(moment, angles[sample]), last, atol=1e-9)
    assert np.abs(last - tables.command[-1]).max() > 1e-3  # it did correct


def test_stiffer_controllers_are_told_less(planned: Planned) -> None:
    plan = planned()
    own = build_regulator_tables(plan)
    stiff = build_regulator_tables(plan, 2.0 * plan.robot.joint_stiffness)
    torque = own.deflection / own.compliance_ratio * plan.robot.joint_stiffness
    np.testing.assert_allclose(
        stiff.deflection / stiff.compliance_ratio * 2.0 * plan.robot.joint_stiffness,
        torque,
        atol=1e-9,
    )


def test_no_memory_is_taken_while_it_ticks(planned: Planned) -> None:
    tables = build_regulator_tables(planned())
    regulator, angles = JointRegulator(tables), seen(tables)
    moments = tables.time.tolist()
    for moment, angle in zip(moments[:20], angles[:20], strict=True):
        regulator.tick(moment, angle)
    tracemalloc.start()
    try:
        tracemalloc.reset_peak()
        begin, _ = tracemalloc.get_traced_memory()
        for moment, angle in zip(moments[20:], angles[20:], strict=True):
            regulator.tick(moment, angle)
        end, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert end - begin < 2_000  # of hundreds of ticks
    assert peak - begin < 6_000  # views of rows, no arrays


def test_time_does_not_go_back_and_angles_are_numbers(planned: Planned) -> None:
    tables = build_regulator_tables(planned())
    regulator = JointRegulator(tables)
    regulator.tick(1.0, seen(tables)[20])
    with pytest.raises(ValueError, match="goes back"):
        regulator.tick(0.5, seen(tables)[20])
    with pytest.raises(ValueError, match="no number"):
        regulator.tick(1.5, np.full_like(tables.toes, np.nan))


RUN = """
import sys
sys.path.insert(0, ".")
from joint_regulator import JointRegulator, read_tables
import numpy as np
tables = read_tables("regulator.npz")
regulator = JointRegulator(tables)
told = [regulator.tick(t, c + b / tables.compliance_ratio).copy()
        for t, c, b in zip(tables.time.tolist(), tables.command, tables.deflection)]
assert not any(name.startswith(("climbplan", "scipy")) for name in sys.modules)
np.save("told.npy", told)
"""


def test_the_written_file_runs_alone_and_says_the_same(
    plan_file: Path, planned: Planned, tmp_path: Path
) -> None:
    took = write_regulator(plan_file, None, tmp_path)
    assert 0 < took.median <= took.percentile_99
    subprocess.run([sys.executable, "-I", "-c", RUN], cwd=tmp_path, check=True)
    stored = joint_regulator.read_tables(tmp_path / "regulator.npz")
    regulator = JointRegulator(stored)
    told = [
        regulator.tick(t, angle).copy()
        for t, angle in zip(stored.time.tolist(), seen(stored), strict=True)
    ]
    np.testing.assert_array_equal(np.load(tmp_path / "told.npy"), told)


def test_tables_under_old_names_are_read(planned: Planned, tmp_path: Path) -> None:
    tables = build_regulator_tables(planned())
    old = {"deflection": "bent", "compliance_ratio": "give", "max_deflection": "most"}
    old |= {"internal_projector": "sharing"}
    arrays = {old.get(name, name): value for name, value in vars(tables).items()}
    np.savez(tmp_path / "old.npz", allow_pickle=False, **arrays)
    stored = joint_regulator.read_tables(tmp_path / "old.npz")
    for name, value in vars(tables).items():
        np.testing.assert_array_equal(vars(stored)[name], value)


def test_feet_that_roll_carry_the_body_on(planned: Planned) -> None:
    tables = build_regulator_tables(planned())
    rolled = np.zeros_like(tables.arms)
    rolled[1:] = [0.0, 0.01, 0.0]
    still, rolling = BodyPoseEstimate(tables), BodyPoseEstimate(replace(tables, rolled=rolled))
    body = (tables.toes - tables.com[0]) @ tables.rotation[0]
    for sample in (0, 1):
        still.update(sample, body)
        rolling.update(sample, body)
    np.testing.assert_allclose(rolling.com - still.com, [0.0, 0.01, 0.0], atol=1e-9)


def test_a_heavy_body_is_corrected_slowly(planned: Planned) -> None:
    """On the same springs twice the mass swings at half the square of the frequency."""
    plan = planned()
    assert (compute_stable_rates(plan) == RATE).all()
    slow, slower = (
        compute_stable_rates(replace(plan, robot=replace(plan.robot, mass=times * plan.robot.mass)))
        for times in (20.0, 40.0)
    )
    assert 0 < slow.max() < RATE
    np.testing.assert_allclose(slower, slow / 2)
    # No rate is slow enough for a body whose forces take all of its stiffness
    soft = replace(plan.robot, joint_stiffness=0.2 * plan.robot.joint_stiffness)
    assert not compute_stable_rates(replace(plan, robot=soft)).any()
