"""What strangers' URDFs have: wheels, sprung feet, missing meshes, paths of other machines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from urdf_walkers import QUADRUPED

from climbplan.errors import SpecError
from climbplan.robots.urdf.proposal.postures import describe_unmirrored_bounds, keep_off_bounds
from climbplan.robots.urdf.proposal.propose_robot import (
    detect_legs,
    prepare_detected_legs,
    propose_robot,
)
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.meshes import find_mesh
from climbplan.schema.robots.xml import UrdfFault

pytest.importorskip("pinocchio")

_INERTIAL = (
    '<inertial><mass value="0.2"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
_LIMIT = '<limit lower="{}" upper="{}" effort="60" velocity="10"/>'


def box_link(name: str, length: float) -> str:
    """A link that hangs down by `length` from its joint [m]."""
    return (
        f'<link name="{name}">{_INERTIAL}<collision><origin xyz="0 0 {-length / 2}"/><geometry>'
        f'<box size="0.03 0.03 {length}"/></geometry></collision></link>'
    )


def joint(name: str, kind: str, parent: str, place: str, axis: str, limit: str) -> str:
    """A joint NAME that moves the link NAME_link."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def quadruped(end: str, mesh: str = "") -> str:
    """Four legs of hip, thigh and knee, with an end each: text with {leg} for its name."""
    base = f'<mesh filename="{mesh}"/>' if mesh else '<box size="0.5 0.2 0.1"/>'
    inertial = _INERTIAL.replace("0.2", "8").replace("1e-4", "0.1")
    collision = f"<collision><geometry>{base}</geometry></collision>"
    parts = [f'<link name="base">{inertial}{collision}</link>']
    for leg, x, y in (("FL", 0.2, 1), ("FR", 0.2, -1), ("RL", -0.2, 1), ("RR", -0.2, -1)):
        hip, thigh, knee = f"{leg}_hip", f"{leg}_thigh", f"{leg}_knee"
        revolute = "revolute"
        wide, bent = _LIMIT.format(-0.8, 0.8), _LIMIT.format(-2.6, -0.3)
        parts += [
            joint(hip, revolute, "base", f"{x} {0.08 * y} 0", "1 0 0", wide),
            f'<link name="{hip}_link">{_INERTIAL}</link>',
            joint(thigh, revolute, f"{hip}_link", f"0 {0.08 * y} 0", "0 1 0",
                  _LIMIT.format(-1.5, 2.5)),
            box_link(f"{thigh}_link", 0.25),
            joint(knee, revolute, f"{thigh}_link", "0 0 -0.25", "0 1 0", bent),
            box_link(f"{knee}_link", 0.25),
            end.replace("{leg}", leg),
        ]  # fmt: skip
    return "".join(['<robot name="odd">', *parts, "</robot>"])


_WHEEL = (
    joint("{leg}_wheel", "continuous", "{leg}_knee_link", "0 0 -0.25", "0 1 0",
          '<limit effort="10" velocity="20"/>')
    + f'<link name="{{leg}}_wheel_link">{_INERTIAL}<collision><origin rpy="1.5707963 0 0"/>'
    '<geometry><cylinder radius="0.08" length="0.04"/></geometry></collision></link>'
)  # fmt: skip


def test_a_wheel_is_locked_and_touches_with_its_rim(tmp_path: Path) -> None:
    path = tmp_path / "wheels.urdf"
    path.write_text(quadruped(_WHEEL), encoding="utf-8")
    legs = detect_legs(path)
    assert set(legs.draft.locked) == {f"{leg}_wheel" for leg in ("FL", "FR", "RL", "RR")}
    for toe, name in zip(legs.toes, legs.naming.names, strict=True):
        leg = legs.draft.build_model().read_leg(name)
        assert len(leg.names) == 3
        assert toe.link.endswith("_knee_link")
        assert np.allclose(toe.offset, (0.0, 0.0, -0.33), atol=5e-3)


def test_a_foot_behind_a_short_slide_is_the_toe(tmp_path: Path) -> None:
    slide = joint("{leg}_spring", "prismatic", "{leg}_knee_link", "0 0 -0.25", "0 0 1",
                  _LIMIT.format(0, 0.005))  # fmt: skip
    foot = (
        box_link("{leg}_spring_link", 0.05)
        + '<joint name="{leg}_tip" type="fixed"><parent link="{leg}_spring_link"/>'
        '<child link="{leg}_foot"/><origin xyz="0 0 -0.05"/></joint><link name="{leg}_foot"/>'
    )
    path = tmp_path / "springs.urdf"
    path.write_text(quadruped(slide + foot), encoding="utf-8")
    for toe in detect_legs(path).toes:
        assert toe.link.endswith("_knee_link")
        assert np.allclose(toe.offset, (0.0, 0.0, -0.3), atol=1e-4)


@pytest.mark.parametrize("name", ["package://other/hull.stl", "file:///opt/ros/share/no/hull.stl"])
def test_one_missing_mesh_leaves_the_other_shapes(tmp_path: Path, name: str) -> None:
    path = tmp_path / "partly.urdf"
    path.write_text(quadruped("", mesh=name), encoding="utf-8")
    legs = detect_legs(path)
    assert legs.geometry_error == ""
    assert {shape.joint for shape in legs.shapes} >= {"FL_thigh", "RR_knee"}
    robot = prepare_detected_legs(legs)
    assert any(name in text for text in robot._list_assumptions())
    section = "\n".join(f"  {leg}: {{toe: {leg}_knee_link}}" for leg in ("FL", "FR", "RL", "RR"))
    spec = tmp_path / "robot.yaml"
    text = f"kind: robot\nurdf: partly.urdf\nmissing_meshes: ignore\nlegs:\n{section}\n"
    spec.write_text(text, encoding="utf-8")
    assert load_any_robot(spec)
    spec.write_text(text.replace("ignore", "refuse"), encoding="utf-8")
    with pytest.raises(SpecError, match="missing_meshes: ignore"):
        load_any_robot(spec)


def test_meshes_of_other_machines_are_found_by_package_or_by_their_end(tmp_path: Path) -> None:
    folder = tmp_path / "leg_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    mesh, urdf = folder / "meshes" / "a.stl", folder / "urdf" / "r.urdf"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(mesh)
    for name in (
        "package://leg_description/meshes/a.stl",
        "package://renamed/meshes/a.stl",
        "file:///opt/ros/humble/share/leg_description/meshes/a.stl",
        "file:///home/you/ws/src/leg_description/meshes/a.stl",
    ):
        assert find_mesh(name, urdf, {}, tmp_path) == mesh.resolve(), name
    for name in ("package://renamed/a.stl", "file:///opt/share/x/b.stl"):
        with pytest.raises(UrdfFault):
            find_mesh(name, urdf, {}, tmp_path)


def test_postures_keep_a_degree_off_joint_bounds(tmp_path: Path) -> None:
    lower, upper = keep_off_bounds(
        np.array([[-1.0, -0.01, -np.inf]]), np.array([[1.0, 0.01, np.inf]])
    )
    assert np.rad2deg(lower[0, 0] + 1.0) == pytest.approx(1.0)
    assert upper[0, 1] == pytest.approx(0.01 - 0.02 * 0.02)
    assert np.isinf(lower[0, 2])
    QUADRUPED.write(tmp_path / "q.urdf")
    found = propose_robot(tmp_path / "q.urdf")
    assert (found.posture.angles >= found.robot.joint_lower + np.deg2rad(0.9)).all()
    assert (found.posture.angles <= found.robot.joint_upper - np.deg2rad(0.9)).all()


def test_bounds_that_are_not_mirrored_are_told(tmp_path: Path) -> None:
    QUADRUPED.write(tmp_path / "q.urdf")
    legs = prepare_detected_legs(detect_legs(tmp_path / "q.urdf")).legs
    assert describe_unmirrored_bounds(legs) == []
    lower = legs.lower.copy()
    lower[0, 0] = -0.3
    (note,) = describe_unmirrored_bounds(replace(legs, lower=lower))
    assert "not mirrored" in note
