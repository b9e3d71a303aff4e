"""Bounds of coxae as half spaces of toes in the convex statement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.motion.motion import StageClock, plan_motion
from climbplan.climb.postures.coxa_wedges import compute_wedge_normals
from climbplan.climb.postures.statement import (
    LinearisedRotation,
    PostureMargins,
    build_posture_program,
)
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body

# A narrow stance on level ground, in which middle legs would turn too far
NARROW = """\
kind: climb
robot: silvia
terrain:
  friction: 0.8
  regions: [{name: ground, vertices: [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]}]
  free_regions: [{name: air, vertices: [[-2, -2, 0.05], [2, -2, 0.05], [2, 2, 0.05], [-2, 2, 0.05],
    [-2, -2, 1], [2, -2, 1], [2, 2, 1], [-2, 2, 1]]}]
task:
  rounds: 3
  start: {com: [0, 0, 0.28]}
  goal: {com: [0, 0.3, 0.28]}
  stance: {RF: [0.25, 0.34, -0.28], RM: [0.36, 0, -0.28], RR: [0.25, -0.34, -0.28],
    LR: [-0.25, -0.34, -0.28], LM: [-0.36, 0, -0.28], LF: [-0.25, 0.34, -0.28]}
"""


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> ClimbScene:
    path = Path(tmp_path_factory.mktemp("narrow"), "narrow.yaml")
    path.write_text(NARROW)
    loaded = load_climb(path)
    return build_scene(loaded.spec, loaded.robot)


def test_rows_say_what_inverse_kinematics_says(narrow: ClimbScene) -> None:
    robot, rng = narrow.robot, np.random.default_rng(0)
    for limb in range(robot.limb_count):
        toes = np.tile(robot.stance_body, (300, 1, 1))
        toes[:, limb] += rng.uniform(-0.12, 0.12, (300, 3)) * [1.0, 1.0, 0.1]
        coxa = solve_inverse_kinematics(robot, toes).angles[
            :, 0, limb, 0
        ]  # the branch that faces the toe
        lower, upper = robot.joint_lower[limb, 0], robot.joint_upper[limb, 0]
        off = toes[:, limb] - robot.shoulder_body[limb]
        inside = (off @ compute_wedge_normals(robot, limb).T >= 0).all(axis=1)
        np.testing.assert_array_equal(inside, (coxa >= lower) & (coxa <= upper))
        closer = (off @ compute_wedge_normals(robot, limb, 0.1).T >= 0).all(axis=1)
        np.testing.assert_array_equal(closer, (coxa >= lower + 0.1) & (coxa <= upper - 0.1))


def test_rows_turn_with_the_body_to_first_order(narrow: ClimbScene) -> None:
    """Against exact rotations: what is off grows with the square of the turn."""
    program = build_posture_program(narrow)
    rows = {rows.name: rows for rows in program.blocks.rows}
    assert {name for name in rows if "turn_" in name} >= {"workspace.turn_RM", "workspace.turn_LM"}
    robot, limb = narrow.robot, narrow.robot.limb_names.index("RM")
    assert LinearisedRotation.from_scene(narrow).level == pytest.approx(np.zeros(3))
    off = []
    for size in (0.02, 0.04):
        rpy = size * np.array([0.3, -0.5, 1.0])
        toes = np.tile(narrow.start.toes, (3, 1, 1))
        com = np.tile(narrow.start.com, (3, 1))
        x = program.point({"toe": toes, "com": com, "rpy": np.tile(rpy, (3, 1))})
        instance = program.instantiate()
        names = [r.name for r in program.blocks.rows for _ in range(len(r.expression))]
        first = names.index("workspace.turn_RM")
        stated = (instance.A @ x - instance.row_lower)[first : first + 2]
        seen = to_body(com[:1], rpy[None], toes[:1])[0, limb] - robot.shoulder_body[limb]
        off.append(float(np.abs(compute_wedge_normals(robot, limb) @ seen - stated).max()))
    assert 0 < off[0] < 1e-3
    assert off[1] < 4.5 * off[0]


def test_narrow_stances_are_planned_without_smaller_workspaces(narrow: ClimbScene) -> None:
    motion = plan_motion(narrow, StageClock(lambda stage, fraction: None))
    assert not motion.tightenings
    wide = replace(narrow.robot, joint_lower=narrow.robot.joint_lower - 1.0)
    wide = replace(wide, joint_upper=wide.joint_upper + 1.0)
    freer = build_posture_program(replace(narrow, robot=wide), PostureMargins())
    assert not [rows for rows in freer.blocks.rows if "turn_" in rows.name]
