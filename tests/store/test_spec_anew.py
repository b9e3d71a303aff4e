"""What a plan's spec determines is built anew: nothing that the file says of it is believed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_climb import Climb, _robot

from climbplan.climb.check.verification import verify
from climbplan.climb.plan import layout
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.errors import UnsoundPlan
from climbplan.schema.robots.stored import RobotTexts
from climbplan.schema.yaml_source import write_yaml
from climbplan.verification.check import Check

RF, RM = 0, 1
BLOCK_B = "terrain/obstacles/0000/b"
Change = Callable[[h5py.File], None]


def check_of(path: Path, name: str = "robot.spec") -> Check:
    (check,) = (c for c in verify(path).checks if c.name == name)
    return check


@pytest.fixture(scope="module")
def carried(climb: Climb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan whose spec names a robot file, and that carries its text."""
    text = climb.plan.spec_text.replace("robot: hexapod", "robot: robots/hexapod.yaml")
    plan = replace(
        climb.plan,
        spec_text=text,
        spec_sha256=hashlib.sha256(text.encode()).hexdigest(),
        robot_texts=RobotTexts(yaml=write_yaml(_robot().model_dump(mode="json"))),
    )
    path = tmp_path_factory.mktemp("carried") / "plan.h5"
    write_climb(plan, path)
    return path


@pytest.fixture
def copy(carried: Path, tmp_path: Path) -> Path:
    path = tmp_path / "plan.h5"
    path.write_bytes(carried.read_bytes())
    return path


def test_a_plan_carries_its_robot(carried: Path) -> None:
    verification = verify(carried)
    assert verification.passed
    assert check_of(carried).margin == ""
    assert "link_lengths" in read_climb(carried).robot_texts.yaml


@pytest.mark.parametrize("name", [n for n, s in layout.ROBOT.items() if s.kind == "float"])
def test_every_number_of_the_robot_is_compared(name: str, copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        values = file[f"robot/{name}"][()]
        values[(-1,) * values.ndim] += 1e-6 * max(1.0, abs(values[(-1,) * values.ndim]))
        file[f"robot/{name}"][...] = values
    check = check_of(copy)
    assert not check.passed
    assert f"robot.{name}" in check.worst_at


@pytest.mark.parametrize("name", layout.ROBOT_NUMBERS)
def test_and_every_single_one(name: str, copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["robot"].attrs[name] += 1e-4
    assert f"robot.{name}" in check_of(copy).worst_at


def test_a_joint_bound_is_named_in_the_robots_terms(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["robot/joint_upper"][RM, 1] *= 1e6
    words = check_of(copy).worst_at
    assert words.startswith("robot.joint_upper, RM femur: 1.65806e+06 in the file, 1.65806 by")


def test_another_text_is_another_robot(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        text = file["robot"].attrs["source"]
        file["robot"].attrs["source"] = text.replace("mass: 10.0", "mass: 9.0")
    assert "robot.mass: 10 in the file, 9 by the spec" in check_of(copy).worst_at
    with h5py.File(copy, "r+") as file:
        file["robot"].attrs["source"] = "kind: robot\n"
    assert not check_of(copy).passed


def test_a_plan_without_its_robot_says_so(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        del file["robot"].attrs["source"]
    check = check_of(copy)
    assert check.passed
    assert "not compared, the plan does not carry robots/hexapod.yaml" in check.margin
    assert "taken from the plan file" in verify(copy).table()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f["terrain/surfaces/0000"].attrs.__setitem__("friction", 1.2), "friction: 1.2"),
        (lambda f: f["terrain/obstacles/0000/b"].__setitem__(0, f[BLOCK_B][0] + 1e-8), "block.b: "),
        (lambda f: f["terrain/allowed"].__setitem__((RF, 0), True), "terrain.allowed, RF"),
        (lambda f: f.__delitem__("terrain/obstacles/0000"), "0 in the file, 1 asked"),
    ],
)
def test_the_terrain_is_the_specs(change: Change, words: str, copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        change(file)
    check = check_of(copy, "terrain.spec")
    assert not check.passed
    assert words in check.worst_at


def test_nothing_is_made_of_an_unsound_plan(copy: Path) -> None:
    verify(copy).require_sound(copy)
    with h5py.File(copy, "r+") as file:
        file["robot/joint_stiffness"][RM, 1] = 1e-300
    with pytest.raises(UnsoundPlan, match=r"robot\.data \(joint_stiffness of RM is not from 0\.01"):
        verify(copy).require_sound(copy)
    with h5py.File(copy, "r+") as file:
        file["instants/force"][0, 0, 0] = np.nan
    with pytest.raises(UnsoundPlan, match=r"file\.finite \(instants/force\)"):
        verify(copy).require_sound(copy)
