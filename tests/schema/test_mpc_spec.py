"""MPC specs: every mistake with its line and key, the robot file's included."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.errors import SpecError
from climbplan.walking.problem.problem import build_task
from climbplan.walking.schema.loading import load_body, load_mpc


def mistakes(text: str, folder: Path) -> str:
    (folder / "walk.yaml").write_text(text)
    with pytest.raises(SpecError) as caught:
        load_mpc(folder / "walk.yaml")
    return str(caught.value)


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    text = """\
kind: mpc
robot: scalar
task:
  knot: 9
  dt: -1
  start: {rpy_deg: [0, 95, 0]}
terrain:
  regions:
    - {name: a, x: [0, 1], y: [0, 1]}
    - {name: b, x: [0.5, 2], y: [0, 1]}
solver: {method: serch}
weights: {velocity: [1, -1, 1]}
"""
    said = mistakes(text, tmp_path)
    for line, words in (
        (2, "did you mean 'scaler'"),
        (4, "did you mean 'knots'"),
        (5, "task.dt"),
        (6, "pitch"),
        (10, "overlaps region 'a'"),
        (11, "did you mean 'gait-search'"),
        (12, "weights.velocity"),
    ):
        assert any(f":{line}: " in row and words in row for row in said.splitlines()), words


def test_legs_that_are_not_there(tmp_path: Path) -> None:
    said = mistakes("kind: mpc\ntask:\n  start: {toes: {LR: [0, 0]}}\n", tmp_path)
    assert "no leg 'LR'" in said
    assert ":3: " in said


def test_mistakes_of_the_robot_file(tmp_path: Path) -> None:
    body = """\
kind: rigid-body
name: box
mass: -3
inertia: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]
force_limit: 10
toe_half: [0.1, 0.1, 0.1]
legs: {A: [1, 1, -1], B: [1, -1, -1], C: [-1, 1, -1], D: [-1, -1, -1]}
"""
    (tmp_path / "box.yaml").write_text(body)
    said = mistakes("kind: mpc\nrobot: box.yaml\n", tmp_path)
    assert "box.yaml:3: mass" in said
    (tmp_path / "box.yaml").write_text(body.replace("-3", "3"))
    assert "positive definite" in mistakes("kind: mpc\nrobot: box.yaml\n", tmp_path)


def test_a_robot_that_cannot_stand_and_toes_in_the_air(tmp_path: Path) -> None:
    (tmp_path / "walk.yaml").write_text(
        "kind: mpc\nterrain: {regions: [{name: a, x: [-1, 1], y: [-1, 1]}]}\n"
        "task: {start: {toes: {LF: [2, 0]}}}\n"
    )
    loaded = load_mpc(tmp_path / "walk.yaml")
    weak = loaded.robot.model_copy(update={"force_limit": 15.0})
    with pytest.raises(SpecError, match="cannot carry") as caught:
        build_task(loaded.spec, weak)
    assert "task.start.toes.LF: 1000.0 mm off 'a'" in str(caught.value)


def test_the_published_force_range_cannot_carry_the_robot() -> None:
    body = load_body("scaler")
    assert 4 * 15.0 < body.mass * body.gravity < 2 * body.force_limit
