"""Outer relaxation of the posture problem: every plan of the climb satisfies it.

`build_posture_program` is a restriction: workspaces are balls about a linearised rotation, limbs
and body stay beyond one face of every obstacle in a round, and toes stay near the nominal stance.
Its infeasibility proves nothing. Here everything is widened instead:

- limbs reach as far as their links are long, from anywhere that an allowed rotation may put a
  shoulder;
- only the body's origin stays outside obstacles, at the ends of rounds;
- bounds count only if the spec states them.

Infeasibility of this program proves that the stated climb has no plan.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.postures.statement import build_region_polytope, sum_of_squares
from climbplan.climb.scene.climb_scene import ClimbScene, MotionScene
from climbplan.climb.schema.model import PostureSpec
from climbplan.program import Polytope, Program
from climbplan.program.statement import Expression
from climbplan.robots.five_bar import FiveBar
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.stated import is_stated

SLACK = 1e-6  # [m] by which everything is wider than it is


def compute_max_reach(scene: MotionScene) -> Array:
    """Return the largest distance (N,) [m] of a toe from its shoulder, links stretched out; may be
    inf.
    """
    if isinstance(scene.robot.limbs, FiveBar):
        return np.full(scene.robot.limb_count, np.inf)
    return np.asarray(scene.robot.longest_links.sum(axis=1) + SLACK)


def bound_shoulders(scene: MotionScene) -> list[tuple[Array, Array]]:
    """Return balls relative to the body that contain every shoulder: centres (N, 3) and radii (N,)
    [m].

    One ball is about the body's origin and holds for any rotation. Where the spec states the limit
    of rotations, a second one is about the shoulder at the start's yaw.
    """
    shoulder = scene.robot.shoulder_body
    shoulder_distance = np.linalg.norm(shoulder, axis=1)
    balls = [(np.zeros_like(shoulder), shoulder_distance)]
    limit = np.deg2rad(scene.spec.posture.rotation_limit_deg)
    is_level = np.abs(scene.start.rpy[:2]).max() <= limit
    if (
        is_stated(scene.spec, "posture.rotation_limit_deg")
        and not scene.terrain.is_curved
        and is_level
    ):
        # Roll, pitch and yaw of at most the limit each make a turn of at most three times it, and
        # a turn by t moves a point by 2 sin(t / 2) of its distance.
        max_angle = min(3.0 * limit, np.pi)
        yaw = rotation_world_body(np.array([0.0, 0.0, scene.start.rpy[2]]))
        balls.append((shoulder @ yaw.T, 2.0 * np.sin(max_angle / 2) * shoulder_distance))
    return balls


def find_stated_toes(posture: PostureSpec, scene: MotionScene) -> list[bool]:
    """Return for each limb whether a posture of the spec states where the toe is."""
    return [name in posture.toes for name in scene.robot.limb_names]


def build_outer_program(scene: ClimbScene) -> Program:
    """Build the relaxation that every posture sequence of a plan satisfies, for flat regions."""
    spec, robot, terrain, task = scene.spec.posture, scene.robot, scene.terrain, scene.spec.task
    m, n, steps = task.round_count, robot.limb_count, spec.steps
    tolerance = task.goal.tolerance + SLACK

    p = Program("posture, outer")
    toe = p.continuous("toe", (m, n, 3), unit="m")
    com = p.continuous("com", (m, 3), unit="m")
    coms: Expression = np.concatenate([scene.start.com[None].astype(object), com])  # (M+1, 3)

    # Steps, where the spec bounds them; of toes from the second round on if their start is free
    if is_stated(scene.spec, "posture.steps.com_max"):
        p.ball("steps.com", np.diff(coms, axis=0), steps.com_max + SLACK, unit="m")
    if is_stated(scene.spec, "posture.steps.toe_max"):
        stated_limbs = np.flatnonzero(find_stated_toes(task.start, scene))
        if m > 1:
            p.ball("steps.toe", np.diff(toe, axis=0), steps.toe_max + SLACK, unit="m")
        if len(stated_limbs):
            first_step = toe[0, stated_limbs] - scene.start.toes[stated_limbs]
            p.ball("steps.first_toe", first_step, steps.toe_max + SLACK, unit="m")

    # Toes within their limbs' length of where a shoulder may be
    reach = compute_max_reach(scene)
    if np.isfinite(reach).all():
        for label, (centre, radius) in zip(
            ("reach", "reach_level"), bound_shoulders(scene), strict=False
        ):
            reach_vector = toe - com[:, None] - centre
            p.ball(f"workspace.{label}", reach_vector, np.tile(reach + radius, (m, 1)), unit="m")

    # Toes on regions
    per_limb = [
        [build_region_polytope(terrain.regions[r]) for r in np.flatnonzero(terrain.allowed[i])]
        for i in range(n)
    ]
    p.one_of("contact.region", toe, per_limb * m, unit="m")

    # The body's origin, which its hull surrounds, outside obstacles or in stated free space
    for index, choice in enumerate(terrain.free_choices):
        free = [Polytope.halfspaces(r.name, r.A, r.b + SLACK) for r in choice]
        p.one_of(f"body.clearance_{index}", com, [free] * m, unit="m")

    # Goal
    p.ball("goal.com", com[-1] - scene.goal.com, tolerance, unit="m")
    stated_limbs = np.flatnonzero(find_stated_toes(task.goal, scene))
    if len(stated_limbs):
        p.ball(
            "goal.toes", toe[-1, stated_limbs] - scene.goal.toes[stated_limbs], tolerance, unit="m"
        )
    p.minimise("steps", sum_of_squares(np.diff(coms, axis=0)))
    p.minimise("stance", 1e-3 * sum_of_squares(toe - com[:, None]))
    return p
