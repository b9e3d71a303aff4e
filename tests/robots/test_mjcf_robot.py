"""A robot from an MJCF file is the one that MuJoCo and Pinocchio have, and its URDF's twin."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from mjcf_walkers import ODD, mjcf_of, write_nested_defaults_model
from typer.testing import CliRunner
from urdf_walkers import Walker

from climbplan.cli.app import app
from climbplan.errors import SpecError
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.robots.urdf.robot_builder import build_robot_from_urdf
from climbplan.robots.urdf.shapes import read_collision_shapes
from climbplan.schema.robots.mjcf.places import compute_rpy
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.schema.robots.urdf.tree import parse_urdf, read_urdf
from climbplan.schema.robots.xml import UrdfFault

mujoco = pytest.importorskip("mujoco")
pinocchio = pytest.importorskip("pinocchio")


def robot_file(folder: Path, file: str) -> Path:
    """A robot file of the walker, whose MJCF has no speed limits."""
    names = Walker().names()
    joints = [f"{n}_{k}" for n in names for k in ("yaw", "lift", "knee")]
    lines = ["kind: robot", f"urdf: {file}", "joints:"]
    lines += [f"  {joint}: {{max_speed: 5}}" for joint in joints]
    lines += ["legs:"]
    for name in names:
        lines.append(
            f"  {name}: {{toe: {name}_toe, posture_deg: {{{name}_lift: 35, {name}_knee: 10}}}}"
        )
    path = folder / f"{Path(file).stem}.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_an_mjcf_walker_is_the_same_robot_as_its_urdf(tmp_path: Path) -> None:
    Walker().write(tmp_path / "u.urdf")
    (tmp_path / "m.xml").write_text(mjcf_of(Walker()), encoding="utf-8")
    sources = [load_any_robot(robot_file(tmp_path, file)) for file in ("u.urdf", "m.xml")]
    found = []
    for source in sources:
        assert isinstance(source, UrdfRobot)
        found.append((build_urdf_model(source), build_robot_from_urdf(source)))
    (first, u), (second, m) = found
    assert abs(u.mass - m.mass) < 1e-9
    for name in ("joint_lower", "joint_upper", "max_torque", "stance_body", "body_hull"):
        assert np.abs(getattr(u, name) - getattr(m, name)).max() < 1e-9, name
    assert u.capsules is not None
    assert m.capsules is not None
    assert np.abs(u.capsules.radius - m.capsules.radius).max() < 1e-9
    assert np.abs(u.capsules.ends - m.capsules.ends).max() < 1e-9
    rng = np.random.default_rng(0)
    angles = rng.uniform(u.joint_lower, u.joint_upper, size=(50, *u.joint_lower.shape))
    away = u.mechanism.joint_points(angles) - m.mechanism.joint_points(angles)
    assert np.abs(away).max() < 1e-9
    assert list(first.model.names) == list(second.model.names)
    ones = np.ones(first.model.nq)
    q = pinocchio.randomConfiguration(first.model, -ones, ones)
    weights = [pinocchio.crba(own.model, own.model.createData(), q) for own in (first, second)]
    assert np.abs(weights[0] - weights[1]).max() < 1e-9


def odd(tmp_path: Path) -> Path:
    """The odd file with its mesh."""
    (tmp_path / "meshes").mkdir()
    wedge = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.3, 1]],
        [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    )
    wedge.export(tmp_path / "meshes" / "wedge.stl")
    path = tmp_path / "odd.xml"
    path.write_text(ODD, encoding="utf-8")
    return path


def test_an_odd_file_has_mujocos_own_kinematics_and_masses(tmp_path: Path) -> None:
    path = odd(tmp_path)
    tree = read_urdf(path)
    limits = {n: (j.lower, j.upper, j.effort) for n, j in tree.joints.items() if j.turns}
    assert limits["roll"] == pytest.approx((-np.deg2rad(40), np.deg2rad(40), 10.0))
    assert limits["pitch"] == pytest.approx((-np.deg2rad(40), np.deg2rad(50), 7.0))
    assert limits["knee"][2] is None
    assert tree.joints["knee"].line == 1 + ODD[: ODD.index('name="knee"')].count("\n")
    model = mujoco.MjModel.from_xml_path(str(path))
    own = pinocchio.buildModelFromXML(
        re.sub("<limit[^>]*>", "", tree.text.replace("<capsule", "<cylinder")).replace(
            "revolute", "continuous"
        ),
        pinocchio.JointModelFreeFlyer(),
    )
    assert pinocchio.computeTotalMass(own) == pytest.approx(float(model.body_mass.sum()), abs=1e-9)
    data, mine = mujoco.MjData(model), own.createData()
    rng = np.random.default_rng(1)
    for _ in range(20):
        turned = rng.uniform(-0.5, 0.5, size=3)
        data.qpos[:3] = 0.0
        data.qpos[3:7] = [1, 0, 0, 0]
        data.qpos[7:] = model.qpos0[7:] + turned
        mujoco.mj_forward(model, data)
        q = pinocchio.neutral(own)
        q[7::2], q[8::2] = np.cos(turned), np.sin(turned)
        pinocchio.framesForwardKinematics(own, mine, q)
        toe = mine.oMf[own.getFrameId("ankle_2", pinocchio.FrameType.BODY)].translation
        assert np.abs(toe - data.site_xpos[0]).max() < 1e-9
        centre = pinocchio.centerOfMass(own, mine, q)
        assert np.abs(centre - data.subtree_com[0]).max() < 1e-9
        full = np.array([_column(model, data, k) for k in range(6, model.nv)])[:, 6:]
        mass_matrix = np.triu(pinocchio.crba(own, mine, q))[6:, 6:]
        assert np.abs(mass_matrix - np.triu(full)).max() < 1e-9


def _column(model: Any, data: Any, number: int) -> Any:
    """One column of MuJoCo's mass matrix."""
    unit, out = np.zeros(model.nv), np.zeros(model.nv)
    unit[number] = 1.0
    mujoco.mj_mulM(model, data, out, unit)
    return out


def test_shapes_stand_where_mujoco_has_them(tmp_path: Path) -> None:
    path = odd(tmp_path)
    (tmp_path / "r.yaml").write_text(
        f"kind: robot\nurdf: {path.name}\njoints:\n"
        "  roll: {max_speed: 5}\n  pitch: {max_speed: 5}\n"
        "  knee: {max_speed: 5, max_torque: 9}\n"
        "legs:\n  A: {toe: ankle}\n  B: {toe: ankle_2}\n  C: {toe: ankle}\n",
        encoding="utf-8",
    )
    with pytest.raises(SpecError, match="moves A and B together"):
        load_any_robot(tmp_path / "r.yaml")
    tree = read_urdf(path)
    assert tree.links["trunk"].collision_meshes[0][0] == "meshes/wedge.stl"
    assert "ellipsoid" not in tree.text
    assert parse_urdf(tree.text, path).links == tree.links


def test_capsules_of_a_urdf_are_capsules(tmp_path: Path) -> None:
    text = Walker().text().replace("<cylinder", "<capsule")
    (tmp_path / "u.urdf").write_text(text, encoding="utf-8")
    robot = load_any_robot(robot_file(tmp_path, "u.urdf"))
    assert isinstance(robot, UrdfRobot)
    shapes = [shape for shape in read_collision_shapes(build_urdf_model(robot)) if shape.joint]
    assert {shape.radius for shape in shapes} == {0.02}
    assert all(len(shape.points) == 2 for shape in shapes)


LIFT = '<joint name="L1_lift" class="lift"/>'
BODY = '<geom type="box" size="0.2 0.1 0.04"/>'
CLOSED = '<connect body1="L1_knee_link" body2="R1_knee_link" anchor="0 0 0"/>'
SECOND = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
END = "</worldbody>"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (LIFT, '<joint name="L1_lift" type="ball"/>', "joint 'L1_lift': a ball joint"),
        (BODY, '<geom name="b" type="ellipsoid" size="1 1 1"/>', "geom 'b': of type ellipsoid"),
        (END, f"{END}<equality>{CLOSED}</equality>", "closed chain: <connect> of 'L1_knee_link'"),
        ("<worldbody>", "<worldbdy>", "not XML"),
        ("<freejoint/>", "<freejont/>", "MuJoCo cannot read it: .*freejont"),
        (
            END,
            f'<body name="two"><joint class="yaw"/>{SECOND}</body>{END}',
            "got 'base_link', 'two'",
        ),
        (BODY, '<geom type="mesh" mesh="none"/>', "MuJoCo cannot read it"),
    ],
)
def test_what_has_no_counterpart_is_refused_in_words(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = mjcf_of(Walker())
    assert old in text
    path = tmp_path / "m.xml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(UrdfFault, match=words):
        read_urdf(path)
    run = CliRunner().invoke(app, ["new", "robot", "--urdf", str(path), str(tmp_path)])
    assert run.exit_code == 2


def test_an_sdf_file_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "m.sdf"
    path.write_text('<sdf version="1.6"/>', encoding="utf-8")
    with pytest.raises(UrdfFault, match="an SDF file, which Pinocchio reads only where"):
        read_urdf(path)


def test_rotations_with_a_pitch_of_a_right_angle_keep_every_digit() -> None:
    rng = np.random.default_rng(2)
    for pitch in (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 0.3):
        roll, yaw = rng.uniform(-3, 3, size=2)
        turn = pinocchio.rpy.rpyToMatrix(roll, pitch, yaw)
        again = pinocchio.rpy.rpyToMatrix(*compute_rpy(turn))
        assert np.abs(again - turn).max() < 1e-14


def test_a_model_of_nested_defaults_is_proposed_as_mujoco_has_it(tmp_path: Path) -> None:
    path = tmp_path / "quadruped.xml"
    path.write_text(write_nested_defaults_model(), encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(path))
    proposal = propose_robot(path)
    assert proposal.naming.names == ("RF", "RR", "LR", "LF")
    assert [toe.link for toe in proposal.toes] == ["FR_calf", "RR_calf", "RL_calf", "FL_calf"]
    assert proposal.draft.foot == pytest.approx(0.02)  # the spheres, at whose middle toes are
    assert all(toe.offset == pytest.approx((0.0, 0.0, -0.2)) for toe in proposal.toes)
    assert proposal.robot.mass == pytest.approx(float(model.body_mass.sum()))
    # Limits of classes and of their actuators; the collision box, not the larger picture
    assert proposal.robot.max_torque.tolist() == [[24.0, 24.0, 40.0]] * 4
    assert proposal.body_box is not None
    low, high = proposal.body_box
    np.testing.assert_allclose(high - low, [0.1, 0.36, 0.09], atol=1e-9)
    bounds = {model.joint(i).name: model.jnt_range[i] for i in range(1, model.njnt)}
    for name, angle in proposal.standing.items():
        lower, upper = np.rad2deg(bounds[name])
        assert lower < angle < upper
    assert proposal.braces
