"""What must hold of whole plans, whatever the scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.robots.source import read_robot_text

Data = dict[str, Any]


def two_walls(gap: float = 1.23, rise: float = 0.2) -> Data:
    """A short straight climb between two parallel walls, stated by corners so that it can turn."""
    half = gap / 2

    def wall(name: str, x: float, limbs: list[str]) -> Data:
        corners = [[x, -1.0, -1.0], [x, 1.0, -1.0], [x, 1.0, 1.5], [x, -1.0, 1.5]]
        if x > 0:
            corners.reverse()
        return {"name": name, "vertices": corners, "limbs": limbs}

    return {
        "kind": "climb",
        "robot": "silvia",
        "terrain": {
            "friction": 1.0,
            "regions": [
                wall("west", -half, ["LF", "LM", "LR"]),
                wall("east", half, ["RF", "RM", "RR"]),
            ],
        },
        "task": {
            "rounds": 2,
            "start": {"com": [0.0, 0.0, 0.0]},
            "goal": {"com": [0.0, 0.0, rise]},
        },
    }


def planned(data: Data, folder: Path) -> ClimbPlan:
    path = folder / "spec.yaml"
    path.write_text(yaml.safe_dump(data))
    return plan_climb(load_climb(path))


def turned(data: Data, yaw: float) -> Data:
    """The same task in a world turned about z."""
    rotation = rotation_world_body(np.array([0.0, 0.0, yaw]))
    out: Data = yaml.safe_load(yaml.safe_dump(data))
    for region in out["terrain"]["regions"]:
        region["vertices"] = (np.array(region["vertices"]) @ rotation.T).tolist()
    for posture in (out["task"]["start"], out["task"]["goal"]):
        posture["com"] = (rotation @ np.array(posture["com"])).tolist()
        posture["rpy_deg"] = [0.0, 0.0, float(np.rad2deg(yaw))]
    return out


def scaled(data: Data, factor: float, folder: Path) -> Data:
    """The same task with every length multiplied; torque limits and stiffness follow."""
    robot: Data = yaml.safe_load(read_robot_text("silvia"))
    robot["body_half_size"] = [factor * v for v in robot["body_half_size"]]
    robot["limb_radius"] *= factor
    robot["workspace"] = {k: factor * v for k, v in robot["workspace"].items()}
    for limb in robot["limbs"]:
        for key in ("shoulder", "link_lengths", "stance", "max_torque"):
            limb[key] = [factor * v for v in limb[key]]
        limb["joint_stiffness"] = [factor * v for v in limb["joint_stiffness"]]
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))
    out: Data = yaml.safe_load(yaml.safe_dump(data))
    out["robot"] = "robot.yaml"
    for region in out["terrain"]["regions"]:
        region["vertices"] = (factor * np.array(region["vertices"])).tolist()
    for posture in (out["task"]["start"], out["task"]["goal"]):
        posture["com"] = [factor * v for v in posture["com"]]
    out["task"]["goal"]["tolerance"] = factor * 0.02
    out["posture"] = {
        "steps": {"com_max": factor * 0.15, "toe_max": factor * 0.24},
        "weights": {"rotation": factor**2 * 1e-3, "goal_rotation": factor**2 * 0.1},
        "body_clearance": factor * 0.02,
        "limb_clearance": factor * 0.005,
    }
    out["margins"] = {"depth": factor * 0.005, "edge": factor * 0.01}
    out["trajectory"] = {"swing_clearance": factor * 0.05, "speed": factor * 0.2 / 60}
    return out


@pytest.mark.parametrize("seed", range(6))
def test_random_feasible_scenes_verify(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    data = two_walls(gap=rng.uniform(1.16, 1.24), rise=rng.uniform(0.05, 0.24))
    data["terrain"]["friction"] = float(rng.uniform(0.9, 1.4))
    data["task"]["goal"]["com"][1] = float(rng.uniform(-0.05, 0.05))
    data["task"]["payload"] = {
        "mass": float(rng.uniform(0, 1.5)),
        "offset": rng.uniform(-0.05, 0.05, 3).tolist(),
    }
    data["task"]["gait"] = rng.permutation(["RF", "RM", "RR", "LR", "LM", "LF"]).tolist()
    data = turned(data, rng.uniform(-np.pi, np.pi))
    path = tmp_path / "plan.h5"
    write_climb(planned(data, tmp_path), path)
    verification = verify(path)
    assert verification.passed, verification.table()


@pytest.mark.parametrize("yaw", [0.6, -2.2])
def test_turning_the_world_turns_the_plan(yaw: float, tmp_path: Path) -> None:
    straight = planned(two_walls(), tmp_path)
    other = planned(turned(two_walls(), yaw), tmp_path)
    rotation = rotation_world_body(np.array([0.0, 0.0, yaw]))
    assert other.objective == pytest.approx(straight.objective, rel=1e-3)
    np.testing.assert_allclose(other.rounds.com, straight.rounds.com @ rotation.T, atol=2e-3)
    np.testing.assert_allclose(other.rounds.toes, straight.rounds.toes @ rotation.T, atol=2e-3)
    np.testing.assert_allclose(other.forces.safety_torque, straight.forces.safety_torque, rtol=2e-2)


@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_scaling_all_lengths_scales_the_plan(factor: float, tmp_path: Path) -> None:
    straight = planned(two_walls(), tmp_path)
    other = planned(scaled(two_walls(), factor, tmp_path), tmp_path)
    assert other.objective == pytest.approx(factor**2 * straight.objective, rel=1e-3)
    np.testing.assert_allclose(other.rounds.com, factor * straight.rounds.com, atol=2e-3 * factor)
    np.testing.assert_allclose(other.forces.safety_torque, straight.forces.safety_torque, rtol=2e-2)


def test_same_seed_same_plan(tmp_path: Path) -> None:
    first, second = planned(two_walls(), tmp_path), planned(two_walls(), tmp_path)
    np.testing.assert_array_equal(first.rounds.toes, second.rounds.toes)
    np.testing.assert_array_equal(first.forces.force, second.forces.force)
    np.testing.assert_array_equal(first.trajectory.joint_command, second.trajectory.joint_command)


def test_more_friction_never_loses_a_plan(tmp_path: Path) -> None:
    worst = []
    for friction in (0.8, 1.0, 1.3):
        data = two_walls()
        data["terrain"]["friction"] = friction
        worst.append(planned(data, tmp_path).forces.safety_torque.min())
    assert worst[0] <= worst[1] * 1.001
    assert worst[1] <= worst[2] * 1.001
