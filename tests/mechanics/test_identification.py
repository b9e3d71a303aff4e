"""Known joints and structures are found again; what cannot be told is said."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from limb_tests import SILVIA, Truth, write_tests

from climbplan.errors import SpecError, UsageError
from climbplan.mechanics.identification.fit import FitModel, fit_stiffness
from climbplan.mechanics.identification.limb_model import MeasuredLimb, limb_matrices
from climbplan.mechanics.identification.measurements import AXES, read_measurements
from climbplan.mechanics.identification.slopes import matrices_from
from climbplan.mechanics.identification.study import identify
from climbplan.mechanics.stiffness import limb_stiffness
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import jacobian_body, jacobian_world
from climbplan.schema.robots.source import load_any_robot

PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        Truth(),
        Truth(spatial=False),
        Truth(bad=0.1),
        Truth(even=1e-4),
    ],
    ids=["space", "plane", "bad rows", "structure"],
)
def test_known_stiffness_within_five_percent_at_two_percent_noise(
    truth: Truth, tmp_path: Path
) -> None:
    for seed in range(3):
        write_tests(tmp_path / "tests.csv", truth, seed)
        measured = read_measurements(tmp_path / "tests.csv")
        matrices = matrices_from(measured.series, measured.axes).matrices
        limb = MeasuredLimb(SILVIA, measured.axes)
        found = fit_stiffness(limb, matrices, FitModel(truth.even > 0, False, "known"), seed)
        value = np.array([e.value for e in found.joint_stiffness])
        known = np.array(truth.stiffness)[list(limb.joints)]
        assert np.abs(value / known - 1).max() < 0.05
        assert all(e.lower <= e.value <= e.upper and e.is_determined for e in found.joint_stiffness)


@pytest.mark.slow
def test_structure_is_told_by_a_second_gain_only(tmp_path: Path) -> None:
    """Structure in the joints' shape is 30 % at gain 12, as chapter 4.3 gauges it."""
    shape = 0.3 / 0.7
    write_tests(tmp_path / "one.csv", Truth(shape=shape), 0)
    one = identify(tmp_path / "one.csv", SILVIA)
    value = np.array([e.value for e in one.best.joint_stiffness])
    np.testing.assert_allclose(value, 0.7 * np.array(Truth().stiffness), rtol=0.05)
    assert any("cannot be told from that joint" in line for line in one.findings)

    write_tests(tmp_path / "two.csv", Truth(shape=shape, gains=(12.0, 32.0)), 0)
    two = identify(tmp_path / "two.csv", SILVIA)
    assert two.best.model.by_gain
    assert two.reference_gain == 22
    value = np.array([e.value for e in two.best.joint_stiffness])
    np.testing.assert_allclose(value * 12 / 22, Truth().stiffness, rtol=0.05)
    assert two.best.share is not None
    soft = [12 / gain for gain in (12, 32)]
    mean = np.mean([shape / (shape + s) for s in soft])
    # At the reference gain the joints' part is 12/22 of that at gain 12.
    assert two.best.share.lower < shape / (shape + 12 / 22) < two.best.share.upper or np.isclose(
        two.best.share.value, mean, atol=0.05
    )


def test_slopes_are_free_of_the_preload(tmp_path: Path) -> None:
    write_tests(tmp_path / "tests.csv", Truth(noise=0.0), 3, count=2)
    measured = read_measurements(tmp_path / "tests.csv")
    reduced = matrices_from(measured.series, measured.axes)
    for one in reduced.slopes:
        np.testing.assert_allclose(one.stiffness, one.published, rtol=1e-3, atol=1.0)
    limb = MeasuredLimb(SILVIA, measured.axes)
    angles = np.array([m.posture.angles for m in reduced.matrices])
    known = limb_matrices(limb.jacobians(angles), 1 / np.array(Truth().stiffness), 0.0)
    for matrix, own in zip(reduced.matrices, known, strict=True):
        np.testing.assert_allclose(matrix.stiffness, own, rtol=2e-3, atol=2.0)
    assert reduced.asymmetry.max() < 1e-3


def test_published_mean_follows_a_bad_row_and_the_median_does_not(tmp_path: Path) -> None:
    write_tests(tmp_path / "tests.csv", Truth(noise=0.0), 1, count=1)
    lines = (tmp_path / "tests.csv").read_text().splitlines()
    cells = lines[4].split(",")
    cells[-3] = str(float(cells[-3]) + 500)
    lines[4] = ",".join(cells)
    (tmp_path / "bad.csv").write_text("\n".join(lines))
    good, bad = (
        matrices_from(m.series, m.axes).slopes[0]
        for m in (read_measurements(tmp_path / f"{n}.csv") for n in ("tests", "bad"))
    )
    np.testing.assert_allclose(bad.stiffness[0], good.stiffness[0], rtol=0.01)
    assert abs(bad.published[0] - good.published[0]) > 0.2 * abs(good.published[0])
    assert bad.bad_rows == (2,)


def test_limb_model_is_that_of_the_planner() -> None:
    """The same matrices as eq. (4.7) of the mechanics, for a limb that points along x."""
    angles = np.deg2rad([[10.0, 30.0, -20.0]])
    limb = MeasuredLimb(SILVIA, (0, 1, 2))
    own = limb_matrices(
        limb.jacobians(angles),
        1 / (SILVIA.joint_stiffness[0] * (1 - SILVIA.structural_compliance_share)),
        0.0,
    )[0]
    turned = angles - [[SILVIA.mount_yaw[0], 0.0, 0.0]]
    jacobian = jacobian_world(SILVIA, np.zeros(3), np.broadcast_to(turned, (6, 3)))
    np.testing.assert_allclose(own, limb_stiffness(SILVIA, jacobian)[0], rtol=1e-5)


def test_feet_by_their_distance_alone(tmp_path: Path) -> None:
    """Matrices of a limb whose feet are only known by how far out they are."""
    limb = MeasuredLimb(SILVIA, (0, 2))
    rng = np.random.default_rng(5)
    femur, tibia = rng.uniform(-30, 60, 14), rng.uniform(-30, 35, 14)
    angles = np.deg2rad(np.stack([np.zeros(14), femur, tibia], axis=1))
    out = 0.195 * np.cos(angles[:, 1]) + 0.375 * np.sin(angles[:, 1] + angles[:, 2])
    matrices = limb_matrices(limb.jacobians(angles), 1 / np.array([60.0, 90.0]), 0.0)
    matrices *= 1 + 0.02 * rng.normal(size=(14, 1, 1))
    rows = [
        f"{i},{1e3 * r:.1f},{k[0, 0]:.1f},{k[0, 1]:.1f},{k[1, 1]:.1f}"
        for i, (r, k) in enumerate(zip(out, matrices, strict=True))
        if r > 0.02
    ]
    (tmp_path / "table.csv").write_text(
        "row,r_mm,Kxx_N_per_m,Kxz_N_per_m,Kzz_N_per_m\n" + "\n".join(rows)
    )
    measured = read_measurements(tmp_path / "table.csv")
    found = fit_stiffness(limb, measured.matrices, FitModel(False, False, "horizontal"))
    assert [e.value for e in found.joint_stiffness] == pytest.approx([60, 90], rel=0.1)
    assert found.relative_error < 0.05


def test_rows_and_columns_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("test,femur_deg,dx_mm,dz_mm,fx_N\na,1,2,3,4\n")
    with pytest.raises(SpecError, match="fz: column is missing") as caught:
        read_measurements(path)
    assert {m.key for m in caught.value.mistakes} == {"fz", "tibia_deg"}
    path.write_text("test,femur_deg,tibia_deg,dx_furlong,dz_mm,fx_N,fz_N\na,1,2,3,4,5,6\n")
    with pytest.raises(SpecError, match="unit 'furlong' is not known"):
        read_measurements(path)
    path.write_text("# nothing\n")
    with pytest.raises(UsageError, match="no rows"):
        read_measurements(path)
    write_tests(path, Truth(spatial=False), 0, count=3)
    text = path.read_text().replace("t1,", "t1,x", 1)
    path.write_text(text)
    measured = read_measurements(path)
    assert len(measured.skipped) == 1
    assert "coxa missing or no number" in measured.skipped[0]
    write_tests(path, Truth(spatial=False), 0, count=1)
    single = read_measurements(path)
    one = matrices_from(single.series, single.axes).matrices
    with pytest.raises(UsageError, match="not enough"):
        fit_stiffness(MeasuredLimb(SILVIA, (0, 2)), one, FitModel(True, True, "known"))


def test_joints_of_a_chain_are_told_by_their_names(tmp_path: Path) -> None:
    """A leg of four joints from a URDF, measured in the body's frame."""
    walker = build_robot(load_any_robot("specs/robot_walker.yaml"))
    number = walker.limb_names.index("R2")
    limb = MeasuredLimb(walker, (0, 1, 2), number)
    assert limb.felt == limb.angles.names == ("R2_yaw", "R2_lift", "R2_knee", "R2_ankle")
    truth = np.array([120.0, 150.0, 90.0, 60.0])
    rng = np.random.default_rng(0)
    low, high = walker.joint_lower[number], walker.joint_upper[number]
    rows = [",".join(["test", *(f"{n}_deg" for n in limb.felt), *(f"K{p}_N_per_m" for p in PAIRS)])]
    for test in range(16):
        angles = rng.uniform(low, high)
        matrix = limb_matrices(limb.jacobians(angles[None]), 1 / truth, 0.0)[0]
        matrix = matrix * (1 + 0.01 * rng.normal())
        entries = [matrix[AXES.index(p[0]), AXES.index(p[1])] for p in PAIRS]
        rows.append(f"t{test}," + ",".join(f"{v:.6g}" for v in [*np.rad2deg(angles), *entries]))
    table = tmp_path / "leg.csv"
    table.write_text("\n".join(rows) + "\n")
    found = identify(table, walker, number=number)
    told = [found.robot_file["joints"][name]["stiffness"] for name in limb.felt]
    np.testing.assert_allclose(told, truth, rtol=0.05)
    with pytest.raises(SpecError, match="R1_yaw_deg: column is missing"):
        identify(table, walker, number=walker.limb_names.index("R1"))
    joints = jacobian_body(walker, np.zeros((4, 4)))[number]
    np.testing.assert_allclose(limb.jacobians(np.zeros((1, 4)))[0], joints, atol=1e-15)


def test_joints_that_slide_are_told_in_lengths(tmp_path: Path) -> None:
    robot = build_robot(load_any_robot("specs/robot_telescope.yaml"))
    limb = MeasuredLimb(robot, (0, 1, 2), 0)
    assert limb.felt == ("L1_yaw", "L1_lift", "L1_extend")
    truth, rng = np.array([120.0, 150.0, 9000.0]), np.random.default_rng(0)
    head = ["test", "L1_yaw_deg", "L1_lift_deg", "L1_extend_mm", *(f"K{p}_N_per_m" for p in PAIRS)]
    rows = [",".join(head)]
    for test in range(12):
        angles = rng.uniform(robot.joint_lower[0], robot.joint_upper[0])
        matrix = limb_matrices(limb.jacobians(angles[None]), 1 / truth, 0.0)[0]
        entries = [matrix[AXES.index(p[0]), AXES.index(p[1])] for p in PAIRS]
        told = [*np.rad2deg(angles[:2]), 1e3 * angles[2], *entries]
        rows.append(f"t{test}," + ",".join(f"{v:.9g}" for v in told))
    table = tmp_path / "leg.csv"
    table.write_text("\n".join(rows) + "\n")
    found = identify(table, robot, number=0)
    own = [found.robot_file["joints"][name]["stiffness"] for name in limb.felt]
    np.testing.assert_allclose(own, truth, rtol=0.02)
    assert any(re.match(r"L1_extend: \d+.\d N/m,", line) for line in found.findings)
    table.write_text("\n".join(rows).replace("extend_mm", "extend_deg") + "\n")
    with pytest.raises(SpecError, match="the joint slides; expected L1_extend_mm"):
        identify(table, robot, number=0)
