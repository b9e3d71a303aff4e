"""Walking tasks of robots as `new robot` proposes them, by the commands that a user types."""

from __future__ import annotations

from pathlib import Path

import pytest
from pages import run

A1 = """
climbplan new robot outputs --package example_robot_data:a1_description
climbplan plan-mpc outputs/a1_walk.yaml --set task.knots=20 --set task.start.velocity=[-0.4,0,0] --out outputs/a1_disturbance
climbplan plan-mpc outputs/a1_walk.yaml --set task.knots=24 --set task.start.velocity=[0.5,0,0] --set task.reference.velocity=[0,0.5,0] --set task.reference.rpy_deg=[0,0,90] --out outputs/a1_turn
climbplan plan-mpc outputs/a1_walk.yaml --set task.knots=24 --set task.reference.velocity=[0.4,0,0] --set "terrain.regions=[{name: floor, x: [-1, 0.35], y: [-1, 1], height: 0}, {name: step 1, x: [0.35, 0.6], y: [-1, 1], height: 0.03}, {name: step 2, x: [0.6, 0.85], y: [-1, 1], height: 0.06}, {name: landing, x: [0.85, 4], y: [-1, 1], height: 0.09}]" --set solver.method=gait-search --set solver.max_qp_solves=800 --out outputs/a1_stairs
"""  # noqa: E501
ANYMAL = """
climbplan new robot outputs --package example_robot_data:anymal_b_simple_description/anymal
climbplan plan-mpc outputs/anymal_walk.yaml --set task.knots=14 --out outputs/anymal_forward
climbplan plan-mpc outputs/anymal_walk.yaml --set task.knots=14 --set task.reference.velocity=[0.3,0,0] --set task.start.velocity=[-0.3,0,0] --out outputs/anymal_disturbance
climbplan plan-mpc outputs/anymal_walk.yaml --set task.knots=20 --set task.start.velocity=[0.3,0,0] --set task.reference.velocity=[0,0.3,0] --set task.reference.rpy_deg=[0,0,90] --out outputs/anymal_turn
climbplan plan-mpc outputs/anymal_walk.yaml --set task.knots=18 --set task.reference.velocity=[0.35,0,0] --set "terrain.regions=[{name: floor, x: [-2, 0.5], y: [-2, 2], height: 0}, {name: step 1, x: [0.5, 0.85], y: [-2, 2], height: 0.04}, {name: step 2, x: [0.85, 1.2], y: [-2, 2], height: 0.08}, {name: landing, x: [1.2, 5], y: [-2, 2], height: 0.12}]" --set solver.method=gait-search --set solver.max_qp_solves=800 --out outputs/anymal_stairs
climbplan simulate outputs/anymal_forward
climbplan plan-mpc outputs/anymal_walk.yaml --method online --set task.knots=9 --set library.size=6 --set loop.duration=4 --set "loop.pushes=[{time: 1.0, velocity: [0, 0.5, 0]}]" --out outputs/anymal_pushed
climbplan simulate outputs/anymal_pushed
"""  # noqa: E501


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("commands", [A1, ANYMAL], ids=["a1", "anymal"])
def test_walking_tasks_are_planned_and_simulated(commands: str, tmp_path: Path) -> None:
    for library in ("example_robot_data", "pinocchio", "mujoco"):
        pytest.importorskip(library)
    for line in commands.strip().splitlines():
        done = run(line, tmp_path)
        assert done.returncode == 0, f"{line}\n{done.stderr}"
