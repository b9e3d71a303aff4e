"""A robot from a URDF that walks, and a plan of it, for tests of several rooms."""

from __future__ import annotations

from pathlib import Path

from urdf_walkers import Walker

from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.robot import UrdfRobot
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.planner.planner import plan_walk
from climbplan.walking.schema.loading import load_mpc

WALK = """
kind: mpc
robot: robot.yaml
terrain: {friction: 0.8}
task: {knots: 4, dt: 0.12, min_contacts: 2, reference: {velocity: [0.3, 0, 0]}}
weights: {velocity: [100, 100, 1000], angles: [100, 100, 10], height: 1000}  # a calm body
solver: {method: gait-search, max_qp_solves: 12}
"""


def write_robot(folder: Path, walker: Walker | None = None, more: str = "") -> Path:
    """A robot file beside its URDF; knees bent so that toes have room all round."""
    walker = walker or Walker()
    walker.write(folder / "walker.urdf")
    lines = ["kind: robot", "urdf: walker.urdf", "body_half_size: [0.1, 0.2, 0.05]", more, "legs:"]
    for name in walker.names():
        posture = f"{{{name}_lift: 35, {name}_knee: 10}}"
        lines.append(f"  {name}: {{toe: {name}_toe, posture_deg: {posture}}}")
    path = folder / "robot.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def walking_robot(folder: Path, walker: Walker | None = None, more: str = "") -> UrdfRobot:
    """That robot, loaded."""
    robot = load_any_robot(write_robot(folder, walker, more))
    assert isinstance(robot, UrdfRobot)
    return robot


def planned_walk(folder: Path) -> WalkPlan:
    """Half a second of it walking."""
    write_robot(folder)
    (folder / "walk.yaml").write_text(WALK, encoding="utf-8")
    return plan_walk(load_mpc(folder / "walk.yaml"))
