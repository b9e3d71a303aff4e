"""Robots from URDFs: numbers are Pinocchio's, meshes are found, stances are reached."""

from __future__ import annotations

import importlib
import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
import yaml
from urdf_walkers import OCTOPOD, QUADRUPED, Walker

from climbplan.errors import MissingSolver, SpecError
from climbplan.robots.any_robot import build_robot, list_assumptions
from climbplan.robots.kinematics import joint_points_body, solve_inverse_kinematics, toe_body
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot


def section(walker: Walker, **values: Any) -> dict[str, Any]:
    """A robot section with the legs bent."""
    legs = {
        name: {"toe": f"{name}_toe", "posture_deg": {f"{name}_lift": 30, f"{name}_knee": 20}}
        for name in walker.names()
    }
    return {"kind": "robot", "urdf": "walker.urdf", "legs": legs, **values}


def located(folder: Path, walker: Walker, **values: Any) -> UrdfRobot:
    walker.write(folder / "walker.urdf")
    (folder / "robot.yaml").write_text(yaml.safe_dump(section(walker, **values), sort_keys=False))
    robot = load_any_robot("robot.yaml", folder)
    assert isinstance(robot, UrdfRobot)
    return robot


def built(folder: Path, walker: Walker, **values: Any) -> Robot:
    return build_robot(located(folder, walker, **values))


def refusal(folder: Path, walker: Walker, **values: Any) -> str:
    with pytest.raises(SpecError) as caught:
        built(folder, walker, **values)
    return str(caught.value)


@pytest.mark.parametrize("joints", [3, 4, 5, 6, 7])
def test_toes_and_joints_are_pinocchios(tmp_path: Path, joints: int) -> None:
    walker = replace(QUADRUPED, joints=joints)
    robot = built(tmp_path, walker)
    assert robot.joint_count == joints
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "walker.urdf"))
    data = model.createData()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x forward to y forward
    angles = np.random.default_rng(joints).uniform(robot.joint_lower, robot.joint_upper)
    q = np.zeros(model.nq)
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)
    for names, row in zip(chain.names, angles, strict=True):
        for name, angle in zip(names, row, strict=True):
            q[model.idx_qs[model.getJointId(name)]] = angle
    pinocchio.framesForwardKinematics(model, data, q)
    toes = np.array([data.oMf[model.getFrameId(f"{n}_toe")].translation for n in walker.names()])
    found = toe_body(robot, angles)
    # The body frame's origin is in the centre of mass: all toes are off by the same vector
    offset = toes @ turn.T - found
    np.testing.assert_allclose(offset, np.broadcast_to(offset[0], offset.shape), atol=1e-12)
    first = np.array([data.oMi[model.getJointId(f"{n}_yaw")].translation for n in walker.names()])
    np.testing.assert_allclose(first @ turn.T - robot.shoulder_body, offset, atol=1e-12)


def test_the_body_frame_is_in_the_centre_of_mass(tmp_path: Path) -> None:
    robot = built(tmp_path, QUADRUPED)
    free = pinocchio.buildModelFromUrdf(
        str(tmp_path / "walker.urdf"), pinocchio.JointModelFreeFlyer()
    )
    assert robot.mass == pytest.approx(pinocchio.computeTotalMass(free))
    assert robot.mass == pytest.approx(QUADRUPED.body_mass + 16 * QUADRUPED.link_mass)
    q = pinocchio.neutral(free)
    for name in QUADRUPED.names():
        q[free.idx_qs[free.getJointId(f"{name}_lift")]] = np.deg2rad(30)
        q[free.idx_qs[free.getJointId(f"{name}_knee")]] = np.deg2rad(20)
    centre = pinocchio.centerOfMass(free, free.createData(), q)
    # Symmetric: only the height differs from the base link's origin
    assert robot.shoulder_body[0] == pytest.approx([-0.12, 0.2, -centre[2]])


def test_what_a_urdf_says_of_an_octopod(tmp_path: Path) -> None:
    robot = built(tmp_path, OCTOPOD)
    assert robot.limb_names == tuple(OCTOPOD.names())
    assert robot.sides == ("left", "right") * 4
    assert robot.joint_name(0, 1) == "L1_lift"
    np.testing.assert_allclose(robot.max_torque, 25.0)
    np.testing.assert_allclose(robot.max_joint_speed, 5.0)
    np.testing.assert_allclose(robot.link_lengths, np.tile([0.057, 0.195, 0.375], (8, 1)))
    np.testing.assert_allclose(robot.joint_upper[0], [1.0, 1.5, 1.5])
    # Cylinders of 0.02 m about the links, and the capsules that hold them
    assert 0.02 <= robot.limb_radius < 0.021
    size = robot.body_hull.max(axis=0) - robot.body_hull.min(axis=0)
    np.testing.assert_allclose(size, [0.2, 0.4, 0.08], atol=1e-12)  # its box is 0.4 m forward
    # 0.97 of the reach, which sampling finds up to a per cent or two
    assert 0.95 * 0.627 * 0.97 < robot.reach <= 0.97 * 0.627


def test_balls_hold_what_they_promise(tmp_path: Path) -> None:
    """Toes drawn within both balls are reached within the joint bounds."""
    robot = built(tmp_path, OCTOPOD)
    rng = np.random.default_rng(0)
    away = rng.normal(size=(200, 8, 3))
    away *= (
        robot.stance_radius
        * rng.random((200, 8, 1)) ** (1 / 3)
        / np.linalg.norm(away, axis=-1, keepdims=True)
    )
    toes = robot.stance_body + away
    near = np.linalg.norm(toes - robot.shoulder_body, axis=-1) <= robot.reach
    assert near.mean() > 0.5
    assert solve_inverse_kinematics(robot, toes).valid[near].all()


def test_axes_of_the_base(tmp_path: Path) -> None:
    forward = built(tmp_path, QUADRUPED)
    back = built(tmp_path, QUADRUPED, forward="-x")
    turned = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(back.shoulder_body, forward.shoulder_body * turned, atol=1e-12)
    assert back.sides[0] == "right"


def test_a_base_may_lie_on_its_front(tmp_path: Path) -> None:
    upright = built(tmp_path, QUADRUPED)
    lying = built(tmp_path, QUADRUPED, forward="z", up="-x")
    for name in ("shoulder_body", "stance_body"):
        turned = vars(upright)[name][:, [0, 2, 1]] * [1.0, 1.0, -1.0]
        np.testing.assert_allclose(vars(lying)[name], turned, atol=1e-12)


def test_given_stances_bend_the_posture(tmp_path: Path) -> None:
    values = section(QUADRUPED)
    stance = [-0.6, 0.3, -0.1]
    values["legs"]["L1"]["stance"] = stance
    robot = built(tmp_path, QUADRUPED, legs=values["legs"])
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)
    np.testing.assert_allclose(robot.stance_body[0], stance)
    np.testing.assert_allclose(toe_body(robot, chain.posture)[0], stance, atol=1e-8)
    values["legs"]["L1"]["stance"] = [-1.6, 0.3, -0.1]
    said = refusal(tmp_path, QUADRUPED, legs=values["legs"])
    assert (
        "robot.yaml:9: legs.L1.stance: stance (-1.600, 0.300, -0.100) m cannot be reached" in said
    )
    assert "cannot be reached, too far" in said


def test_stretched_legs_are_refused(tmp_path: Path) -> None:
    values = section(QUADRUPED)
    values["legs"]["R2"]["posture_deg"] = {"R2_lift": 0, "R2_knee": 85.9, "R2_ankle": 0}
    said = refusal(tmp_path, QUADRUPED, legs=values["legs"])
    assert (
        "legs.R2: its toe stands 627 mm from its first joint, nearer to full stretch than" in said
    )


def test_legs_of_different_make(tmp_path: Path) -> None:
    """A leg of three joints beside legs of four: it begins with a joint that is none."""
    text = QUADRUPED.text().replace(
        'name="L1_ankle" type="revolute"', 'name="L1_ankle" type="fixed"'
    )
    (tmp_path / "walker.urdf").write_text(text)
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(section(QUADRUPED), sort_keys=False))
    robot = build_robot(load_any_robot("robot.yaml", tmp_path))
    moved = robot.stance_body + np.array([0.0, 0.03, 0.04])
    assert robot.has_joint.sum(axis=1).tolist() == [3, 4, 4, 4]
    solution = solve_inverse_kinematics(robot, moved)
    assert solution.valid.all()
    points = joint_points_body(robot, solution.best())
    np.testing.assert_allclose(points[:, -1], moved, atol=1e-8)
    assert robot.joint_name(0, 0) == "L1_yaw"


def write_stl(path: Path, half: tuple[float, float, float]) -> None:
    """A box as text STL, twelve triangles."""
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half
    faces = []
    for axis, sign in itertools.product(range(3), (-1, 1)):
        a, b, c, d = corners[np.sign(corners[:, axis]) == sign]
        faces += [(a, b, c), (b, c, d)]
    lines = [
        f"facet normal 0 0 0 outer loop {' '.join(f'vertex {x} {y} {z}' for x, y, z in face)} "
        "endloop endfacet"
        for face in faces
    ]
    text = "solid box\n" + "\n".join(lines) + "\nendsolid box\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text.replace(" vertex", "\nvertex").replace(" end", "\nend"))


@pytest.mark.parametrize("how", ["relative", "absolute", "file", "package", "above", "ros path"])
def test_meshes_are_found(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "walker_description" / "urdf"
    folder.mkdir(parents=True)
    mesh = tmp_path / "walker_description" / "meshes" / "body.stl"
    values: dict[str, Any] = {}
    name = "package://walker_description/meshes/body.stl"
    if how == "relative":
        name = "../meshes/body.stl"
    elif how == "absolute":
        name = str(mesh)
    elif how == "file":
        name = mesh.as_uri()
    elif how in ("package", "ros path"):
        elsewhere = tmp_path / "elsewhere" / "other_description"
        mesh = elsewhere / "body.stl"
        name = "package://other_description/body.stl"
        values = {"packages": {"other_description": "../../elsewhere/other_description"}}
        if how == "ros path":
            values = {}
            monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere"))
    write_stl(mesh, (0.3, 0.1, 0.05))
    robot = built(folder, replace(QUADRUPED, mesh=name), **values)
    size = robot.body_hull.max(axis=0) - robot.body_hull.min(axis=0)
    np.testing.assert_allclose(size, [0.2, 0.6, 0.1], atol=1e-6)


def write_dae(path: Path, half: tuple[float, float, float], up: str) -> None:
    """A box as COLLADA."""
    corners = list(itertools.product(*((-h, h) for h in half)))
    places = " ".join(f"{value:g}" for corner in corners for value in corner)
    faces = ["0 1 3 2", "4 6 7 5", "0 4 5 1", "2 3 7 6", "0 2 6 4", "1 5 7 3"]
    around = " ".join(f"{a} {b} {c} {a} {c} {d}" for a, b, c, d in map(str.split, faces))
    path.write_text(
        f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="24">{places}</float_array><technique_common>
<accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{around}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>
"""
    )


@pytest.mark.parametrize("up", ["Z_UP", "Y_UP"])
def test_a_collada_file_says_which_way_is_up(tmp_path: Path, up: str) -> None:
    lengths = (0.3, 0.1, 0.05) if up == "Z_UP" else (0.3, 0.05, 0.1)
    write_dae(tmp_path / "body.dae", lengths, up)
    robot = built(tmp_path, replace(QUADRUPED, mesh="body.dae"))
    size = robot.body_hull.max(axis=0) - robot.body_hull.min(axis=0)
    np.testing.assert_allclose(size, [0.2, 0.6, 0.1], atol=1e-6)


def test_meshes_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "body.stl").write_text("no mesh at all")
    said = refusal(tmp_path, replace(QUADRUPED, mesh="body.stl"))
    assert "robot.yaml:2: urdf: its collision geometry cannot be read: " in said
    own = {"limb_radius": 0.03, "body_half_size": [0.1, 0.2, 0.05]}
    robot = built(tmp_path, replace(QUADRUPED, mesh="body.stl"), **own)  # then no mesh is read
    assert robot.limb_radius == 0.03
    np.testing.assert_allclose(robot.body_hull.max(axis=0), [0.1, 0.2, 0.05])


def test_assumptions_are_told(tmp_path: Path) -> None:
    robot = located(tmp_path, QUADRUPED)
    (said,) = list_assumptions(robot, build_robot(robot))
    assert said.startswith("assumed of walker4: joint_stiffness 50 N m/rad: no URDF says it; ")
    assert "structural_compliance_share 0" in said
    given = {"joint_stiffness": 80, "structural_compliance_share": 0.2}
    robot = located(tmp_path, QUADRUPED, **given, workspace={"stance_radius": 0.1})
    assert list_assumptions(robot, build_robot(robot)) == ()


def test_other_joints_are_held(tmp_path: Path) -> None:
    head = (
        '<joint name="neck" type="continuous"><parent link="base_link"/><child link="head"/>'
        '<origin xyz="0.3 0 0.1"/></joint><link name="head"><inertial><mass value="2"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>'
    )
    (tmp_path / "walker.urdf").write_text(QUADRUPED.text().replace("</robot>", head))
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(section(QUADRUPED), sort_keys=False))
    located_robot = load_any_robot("robot.yaml", tmp_path)
    robot = build_robot(located_robot)
    assert robot.mass == pytest.approx(QUADRUPED.body_mass + 16 * QUADRUPED.link_mass + 2)
    assert robot.shoulder_body[0, 1] < 0.2  # the head pulls the centre of mass forward
    assert "held at zero, as no leg has them: neck" in list_assumptions(located_robot, robot)[0]


def test_without_pinocchio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    robot = located(tmp_path, QUADRUPED)
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(MissingSolver, match=r"needs Pinocchio.*pip install 'climbplan\[urdf\]'"):
        build_robot(robot)
