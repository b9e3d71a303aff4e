"""Robots from the texts that plans carry are those from the files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.robots.any_robot import build_robot
from climbplan.schema.robots.stored import (
    NotKept,
    RobotTexts,
    build_stored_robot,
    collect_robot_texts,
)
from climbplan.schema.yaml_source import parse_yaml
from climbplan.verification.differences import compare_recursively, select_largest

SPECS = Path(__file__).parents[2] / "specs"
WALKER = parse_yaml("kind: climb\nrobot: robot_walker.yaml\n", "spec")


@pytest.fixture(scope="module")
def texts() -> RobotTexts:
    loaded = load_climb(SPECS / "climb_walker.yaml")
    return collect_robot_texts(loaded.spec.robot, loaded.directory, loaded.robot)


def test_a_urdf_travels_as_text(texts: RobotTexts) -> None:
    pytest.importorskip("pinocchio")
    loaded = load_climb(SPECS / "climb_walker.yaml")
    stored = build_stored_robot(WALKER, texts)
    assert stored.unknown == ()
    parts = compare_recursively("robot", build_robot(stored.robot), build_robot(loaded.robot))
    assert select_largest(parts).size == 0.0


def _put_mesh(urdf: str) -> str:
    """Return a URDF with a mesh for the first collision geometry."""
    start = urdf.index("<geometry>", urdf.index("<collision")) + len("<geometry>")
    end = urdf.index("</geometry>", start)
    return urdf[:start] + '<mesh filename="package://walker/trunk.stl"/>' + urdf[end:]


def test_meshes_do_not(texts: RobotTexts) -> None:
    with_mesh = _put_mesh(texts.urdf)
    assert build_stored_robot(WALKER, RobotTexts(texts.yaml, with_mesh)).unknown == (
        "limb_radius",
        "capsules",
        "touching",
        "body_hull",
        "body_parts",
    )
    told = texts.yaml + "\nlimb_radius: 0.03\n"
    assert build_stored_robot(WALKER, RobotTexts(told, with_mesh)).unknown == (
        "body_hull",
        "body_parts",
        "touching",
    )


def test_what_meshes_tell_is_taken_from_the_robot_of_the_plan(texts: RobotTexts) -> None:
    pytest.importorskip("pinocchio")
    built = build_robot(load_climb(SPECS / "climb_walker.yaml").robot)
    fields = {name: getattr(built, name) for name in vars(built)}
    fields["limb_radius"] = 0.017
    stored = build_stored_robot(WALKER, RobotTexts(texts.yaml, _put_mesh(texts.urdf)))
    expected = replace(built, limb_radius=0.017)
    parts = compare_recursively("robot", build_robot(stored.with_mesh_fields(fields)), expected)
    assert select_largest(parts).size == 0.0
    del fields["body_hull"]
    with pytest.raises(NotKept, match="does not carry the meshes that tell body_hull"):
        stored.with_mesh_fields(fields)


@pytest.mark.parametrize(
    ("spec", "has_yaml", "words"),
    [
        ("robot: robot_walker.yaml", False, "the plan does not carry robot_walker.yaml"),
        ("robot: robot_walker.yaml", True, "the plan does not carry its URDF"),
        ("robot: {urdf: walker.urdf, legs: {}}", False, "the plan does not carry its URDF"),
        ("robot: hexapod", False, "'hexapod' is no built-in robot"),
    ],
)
def test_what_is_not_kept_is_said(spec: str, has_yaml: bool, words: str, texts: RobotTexts) -> None:
    given = RobotTexts(yaml=texts.yaml) if has_yaml else RobotTexts()
    with pytest.raises(NotKept, match=words):
        build_stored_robot(parse_yaml(f"kind: climb\n{spec}\n", "spec"), given)


@pytest.mark.parametrize(
    ("yaml", "urdf"),
    [("kind: robot\n", ""), ("kind: robot\nurdf: a.urdf\n", "<robot/>"), ("- 1\n", "")],
)
def test_texts_that_are_no_robot(yaml: str, urdf: str) -> None:
    with pytest.raises(SpecError):
        build_stored_robot(WALKER, RobotTexts(yaml, urdf))


def test_a_built_in_robot_needs_no_text() -> None:
    loaded = load_climb(SPECS / "climb_obstacle.yaml")
    assert collect_robot_texts(loaded.spec.robot, loaded.directory, loaded.robot) == RobotTexts()
    assert build_stored_robot(loaded.document, RobotTexts()).robot.name == loaded.robot.name
