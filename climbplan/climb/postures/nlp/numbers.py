"""A scene and a start as the numbers of the posture NLP, and its answer as postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.limb_clearance import standing_room
from climbplan.climb.plan.climb_plan import Index, Rounds
from climbplan.climb.postures.nlp.layout import (
    MOMENTS,
    Moment,
    Shape,
    number_layout,
    pin_layout,
    posture_layout,
    variable_layout,
)
from climbplan.climb.postures.nlp.links import parting_planes
from climbplan.climb.scene import ClimbScene
from climbplan.robots.kinematics import inverse, joint_points_body
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.terrain.surfaces import Region, Tube

# [rad] off every joint bound at the moments that are constrained. The second holds the joints at
# the instants between them where the first did not.
JOINT_MARGINS = (1e-3, np.deg2rad(2.0))
_UPRIGHT_PITCH = np.deg2rad(80.0)  # beyond it roll and yaw are no longer told apart


@dataclass(frozen=True)
class Guess:
    """Where IPOPT starts, and the choices that stay as they are in its run."""

    label: str
    rounds: Rounds  # postures, need not satisfy anything; regions are pinned
    free: Index  # (M, choices) free region of the body in every round


@dataclass(frozen=True)
class Box:
    """Bounds of all variables."""

    lower: Array
    upper: Array


def shape_of(scene: ClimbScene) -> Shape:
    """The structure of a scene's NLP."""
    spec, terrain = scene.spec.posture, scene.terrain
    return Shape(
        rounds=scene.spec.task.rounds,
        gait=scene.gait,
        curved=terrain.curved,
        edges=max((len(region.b) for region in terrain.regions), default=0),
        free_rows=sum(max(len(free.b) for free in choice) for choice in terrain.free_choices),
        hull=len(scene.robot.body_hull),
        obstacles=len(terrain.obstacles),
        stance=spec.stance_workspace,
        intermediate=spec.intermediate_reach,
        com_min=spec.steps.com_min > 0,
        toe_min=spec.steps.toe_min > 0,
    )


def parameters(scene: ClimbScene, guess: Guess) -> dict[str, Array]:
    """Start posture, pinned choices of every round (P, M), and all other numbers of the scene."""
    shape, start = shape_of(scene), scene.start
    posture = {"com": start.com[:, None], "rpy": start.rpy[:, None], "toes": start.toes.T}
    planes = _planes(scene, guess)
    pins = [_pins(scene, shape, guess, planes, j) for j in range(shape.rounds)]
    return {
        "start": posture_layout(shape.limbs).pack(posture)[:, None],
        "pins": np.stack(pins, axis=1),
        "numbers": number_layout(shape).pack(_numbers(scene))[:, None],
    }


def _numbers(scene: ClimbScene) -> dict[str, Array]:
    spec, robot, goal = scene.spec.posture, scene.robot, scene.goal
    steps, weights = spec.steps, spec.weights
    wall = scene.terrain.surfaces[0]
    tube = wall if isinstance(wall, Tube) else None
    arrays = {
        "shoulder": robot.shoulder_body.T,
        "stance": robot.stance_body.T,
        "links": robot.link_lengths.T,
        "mount_yaw": robot.mount_yaw[None],
        "hull": robot.body_hull.T,
        "axis": np.zeros((2, 1)) if tube is None else tube.center[:, None],
        "goal_com": goal.com[:, None],
        "goal_rpy": goal.rpy[:, None],
        "goal_toes": goal.toes.T,
    }
    scalars = {
        "radius": 1.0 if tube is None else tube.radius,
        "reach": robot.reach,
        "stance_radius": robot.stance_radius,
        "lift": scene.spec.trajectory.lift,
        "clearance": spec.body_clearance,
        "limb_room": standing_room(scene),
        "hull_radius": np.linalg.norm(robot.body_hull, axis=1).max(),
        "com_max": steps.com_max,
        "com_min": steps.com_min,
        "toe_max": steps.toe_max,
        "toe_min": steps.toe_min,
        "rotation_max": np.deg2rad(steps.rotation_max_deg),
        "tolerance": scene.spec.task.goal.tolerance,
        "rotation_tolerance": np.deg2rad(scene.spec.task.goal.rotation_tolerance_deg),
        "w_goal": weights.goal,
        "w_goal_com": weights.goal_com,
        "w_goal_rotation": weights.goal_rotation,
        "w_com": weights.com,
        "w_toe": weights.toe,
        "w_rotation": weights.rotation,
    }
    return arrays | {name: np.array([[value]]) for name, value in scalars.items()}


def _planes(scene: ClimbScene, guess: Guess) -> dict[str, Array]:
    """Parting planes of links and obstacles at the moments of every round, (M, 4, columns)."""
    robot, found = scene.robot, {}
    for moment in MOMENTS:
        limbs = _limbs_at(scene, guess, moment)
        rotation = rotation_world_body(limbs.rpy)  # (M, N, 3, 3)
        points = joint_points_body(robot, limbs.angles)  # (M, N, 4, 3)
        points = limbs.com[..., None, :] + np.einsum("mnab,mnkb->mnka", rotation, points)
        planes = [
            parting_planes(solid, points[:, :, :-1], points[:, :, 1:])
            for solid in scene.terrain.obstacles
        ]
        columns = np.stack(planes, axis=1) if planes else np.zeros((len(points), 0, 4))
        found[f"planes_{moment.name}"] = np.swapaxes(columns.reshape(len(points), -1, 4), 1, 2)
    return found


def _pins(scene: ClimbScene, shape: Shape, guess: Guess, planes: dict[str, Array], j: int) -> Array:
    """The pinned choices of the round from posture j to posture j + 1."""
    terrain = scene.terrain
    values: dict[str, Array] = {
        # Unused rows hold everywhere: 0 x <= 1.
        "free_rows": np.zeros((3, shape.free_rows)),
        "free_bounds": np.ones((1, shape.free_rows)),
    }
    values |= {name: by_round[j] for name, by_round in planes.items()}
    at = 0
    for choice, chosen in zip(terrain.free_choices, guess.free[j], strict=True):
        free = choice[chosen]
        values["free_rows"][:, at : at + len(free.b)] = free.A.T
        values["free_bounds"][0, at : at + len(free.b)] = free.b
        at += max(len(region.b) for region in choice)
    if not shape.curved:
        regions = terrain.regions
        old, new = ([regions[r] for r in guess.rounds.region[k]] for k in (j, j + 1))
        edges = [_padded_edges(region, shape.edges) for region in new]
        values |= {
            "old_normal": np.stack([region.normal for region in old], axis=1),
            "normal": np.stack([region.normal for region in new], axis=1),
            "offset": np.array([[region.offset for region in new]]),
            "edge_rows": np.concatenate([rows[:3] for rows in edges], axis=1),
            "edge_bounds": np.stack([rows[3] for rows in edges], axis=1),
        }
    return pin_layout(shape).pack(values)


def _padded_edges(region: Region, count: int) -> Array:
    """Edge rows over their bounds, (4, count); rows beyond the region's own hold everywhere."""
    rows = np.zeros((4, count))
    rows[3] = 1.0
    rows[:3, : len(region.b)] = region.A.T
    rows[3, : len(region.b)] = region.b
    return rows


def variable_bounds(scene: ClimbScene, joint_margin: float) -> Box:
    """Rotation limits, joint bounds tightened by joint_margin [rad], and a tube's extent."""
    shape, robot = shape_of(scene), scene.robot
    limit = np.full(3, np.deg2rad(scene.spec.posture.rotation_limit_deg))
    limit[1] = min(limit[1], _UPRIGHT_PITCH)
    if shape.curved:
        limit[2] = np.inf  # a tube looks the same from all sides
    toes = np.full(3, np.inf)
    level = np.array([0.0, 0.0, scene.start.rpy[2]])  # a world turned about z changes nothing
    low, high = {"rpy": (level - limit)[:, None]}, {"rpy": (level + limit)[:, None]}
    low |= {"com": np.full((3, 1), -np.inf), "toes": -toes[:, None]}
    high |= {"com": np.full((3, 1), np.inf), "toes": toes[:, None]}
    wall = scene.terrain.surfaces[0]
    if isinstance(wall, Tube):
        low["toes"] = np.array([[-np.inf], [-np.inf], [wall.lower]])
        high["toes"] = np.array([[np.inf], [np.inf], [wall.upper]])
    for moment in MOMENTS:
        low[f"angles_{moment.name}"] = robot.joint_lower.T + joint_margin
        high[f"angles_{moment.name}"] = robot.joint_upper.T - joint_margin
    layout = variable_layout(shape.limbs)
    return Box(*(np.tile(layout.pack(side), shape.rounds) for side in (low, high)))


@dataclass(frozen=True)
class _LimbsAt:
    """All limbs at one moment of every round, each with the body where it then is."""

    com: Array  # (M, N, 3)
    rpy: Array  # (M, N, 3)
    angles: Array  # (M, N, 3)


def _limbs_at(scene: ClimbScene, guess: Guess, moment: Moment) -> _LimbsAt:
    """Poses and joint angles of a guess, knee up where inverse kinematics fails."""
    rounds, n = guess.rounds, scene.robot.limb_count
    share = np.ones(n)
    if not moment.at_end:
        share[list(scene.gait)] = np.arange(n) / n
    com, rpy = (
        x[:-1, None] + share[:, None] * np.diff(x, axis=0)[:, None]
        for x in (rounds.com, rounds.rpy)
    )
    rows = slice(1, None) if moment.new_place else slice(None, -1)
    toes, region = rounds.toes[rows].copy(), rounds.region[rows]
    if moment.clear:
        for j, i in np.ndindex(*region.shape):
            normal = scene.terrain.surfaces[region[j, i]].normal_at(toes[j, i])
            toes[j, i] += scene.spec.trajectory.lift * normal
    inside = np.einsum("mnba,mnb->mna", rotation_world_body(rpy), toes - com)
    solution = inverse(scene.robot, inside)
    angles = np.where(solution.valid[..., None], solution.best(), solution.angles[..., 0, :, :])
    return _LimbsAt(com, rpy, angles)


def first_iterate(scene: ClimbScene, guess: Guess, box: Box) -> Array:
    """All variables at a guess; joint angles by inverse kinematics, within the bounds."""
    rounds = guess.rounds
    values = {
        "com": rounds.com[1:, :, None],
        "rpy": rounds.rpy[1:, :, None],
        "toes": np.swapaxes(rounds.toes[1:], 1, 2),
    }
    for moment in MOMENTS:
        angles = _limbs_at(scene, guess, moment).angles
        values[f"angles_{moment.name}"] = np.swapaxes(angles, 1, 2)
    layout = variable_layout(scene.robot.limb_count)
    by_round = [{k: v[j] for k, v in values.items()} for j in range(rounds.count)]
    x: Array = np.concatenate([layout.pack(v) for v in by_round])
    return x.clip(box.lower, box.upper)


def to_rounds(scene: ClimbScene, guess: Guess, x: Array) -> Rounds:
    """Postures of a solution vector, toes put exactly on their regions."""
    start, layout = scene.start, variable_layout(scene.robot.limb_count)
    parts = layout.unpack(np.reshape(x, (-1, layout.size)))
    toes = np.concatenate([start.toes[None], np.swapaxes(parts["toes"], 1, 2)])
    for j, limb in np.ndindex(*guess.rounds.region[1:].shape):
        surface = scene.terrain.surfaces[guess.rounds.region[j + 1, limb]]
        toes[j + 1, limb] = surface.project(toes[j + 1, limb])
    return Rounds(
        com=np.concatenate([start.com[None], parts["com"][..., 0]]),
        rpy=np.concatenate([start.rpy[None], parts["rpy"][..., 0]]),
        toes=toes,
        region=guess.rounds.region,
    )
