"""Parameters and initial point of the posture NLP for a scene, and postures from its solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.clearance.limbs import compute_standing_clearance
from climbplan.climb.gait.gait import interpolate_poses
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.nlp.layout import (
    MOMENTS,
    Moment,
    NlpStructure,
    build_number_layout,
    build_pin_layout,
    build_posture_layout,
    build_variable_layout,
)
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.robots.kinematics import joint_points_body, solve_inverse_kinematics
from climbplan.robots.rotations import rotation_world_body
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.terrain.model import FreeRegion
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region, Tube

_CONTACT_TOLERANCE = 1e-6  # [m] a corner this close to a face belongs to it


def find_separating_planes(solid: Solid, starts: Array, ends: Array) -> Array:
    """Return the plane (..., 4) with the largest clearance between each link and a solid.

    Candidate normals are those of the faces, and means of adjacent face normals for edges and
    corners. A plane is a unit normal away from the solid and its offset; it touches the solid.

    Args:
        solid: The convex solid.
        starts: (..., 3) first ends of the links [m].
        ends: (..., 3) second ends of the links [m].
    """
    directions = _generate_directions(solid)
    offsets = (solid.vertices @ directions.T).max(axis=0)
    clearance = np.minimum(starts @ directions.T, ends @ directions.T) - offsets
    nearest = clearance.argmax(axis=-1)
    return np.concatenate([directions[nearest], offsets[nearest][..., None]], axis=-1)


def _generate_directions(solid: Solid) -> Array:
    """Return unit normals (D, 3) of faces, and means of those that share an edge or a corner."""
    is_on_face = (
        np.abs(solid.A @ solid.vertices.T - solid.b[:, None]) < _CONTACT_TOLERANCE
    )  # (F, V)
    face_a, face_b = np.nonzero(np.triu(is_on_face.astype(int) @ is_on_face.T >= 2, k=1))
    sums = np.vstack([solid.A, solid.A[face_a] + solid.A[face_b], is_on_face.T @ solid.A])
    unit_normals: Array = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return unit_normals


# [rad] off every joint bound at the moments that are constrained. The second holds the joints at
# the instants between them where the first did not.
JOINT_MARGINS = (1e-3, np.deg2rad(2.0))
_PITCH_LIMIT = np.deg2rad(80.0)  # beyond it roll and yaw are no longer told apart


@dataclass(frozen=True)
class Guess:
    """An initial point of IPOPT, with the choices that stay fixed in its run."""

    label: str
    rounds: Rounds  # postures, need not satisfy anything; regions are fixed
    free_regions: IntArray  # (M, choices) free region of the body in every round


def build_shape(scene: ClimbScene) -> NlpStructure:
    """Return the structure of a scene's NLP."""
    spec, terrain = scene.spec.posture, scene.terrain
    return NlpStructure(
        num_rounds=scene.spec.task.round_count,
        gait=scene.gait,
        is_curved=terrain.is_curved,
        max_edges=max((len(region.b) for region in terrain.regions), default=0),
        num_free_rows=sum(max(len(free.b) for free in choice) for choice in terrain.free_choices),
        num_hull_corners=len(scene.robot.body_hull),
        num_obstacles=len(terrain.obstacles),
        has_stance_ball=spec.stance_workspace,
        checks_during_round=spec.check_reach_during_round,
        has_com_min=spec.steps.com_min > 0,
        has_toe_min=spec.steps.toe_min > 0,
        kinematics=build_symbolic_limbs(scene.robot),
    )


def build_parameters(scene: ClimbScene, guess: Guess) -> dict[str, Array]:
    """Return the parameters of a scene's NLP: start, fixed choices (P, M), values of all rounds."""
    shape, start = build_shape(scene), scene.start
    posture = {"com": start.com[:, None], "rpy": start.rpy[:, None], "toes": start.toes.T}
    return {
        "start": build_posture_layout(shape.limbs).pack(posture)[:, None],
        "pins": build_pin_layout(shape).pack(_build_pins(scene, guess)).T,
        "numbers": build_number_layout(shape).pack(_build_common_parameters(scene))[:, None],
    }


def _build_common_parameters(scene: ClimbScene) -> dict[str, Array]:
    """Return the parameters that hold for all rounds, by name."""
    spec, robot, goal = scene.spec.posture, scene.robot, scene.goal
    steps, wall = spec.steps, scene.terrain.surfaces[0]
    tube = wall if isinstance(wall, Tube) else None
    arrays = {
        **build_symbolic_limbs(robot).compute_robot_parameters(robot),
        "first_joint": robot.shoulder_body.T,
        "stance": robot.stance_body.T,
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
        "lift": scene.spec.trajectory.swing_clearance,
        "clearance": spec.body_clearance,
        "limb_room": compute_standing_clearance(scene),
        "hull_radius": np.linalg.norm(robot.body_hull, axis=1).max(),
        "com_max": steps.com_max,
        "com_min": steps.com_min,
        "toe_max": steps.toe_max,
        "toe_min": steps.toe_min,
        "rotation_max": np.deg2rad(steps.rotation_max_deg),
        "tolerance": scene.spec.task.goal.tolerance,
        "rotation_tolerance": np.deg2rad(scene.spec.task.goal.rotation_tolerance_deg),
        **{f"w_{name}": weight for name, weight in spec.weights},
    }
    return arrays | {name: np.array([[value]]) for name, value in scalars.items()}


def _build_planes(scene: ClimbScene, guess: Guess) -> dict[str, Array]:
    """Return the separating planes of links and obstacles at the moments of every round, (M, 4,
    columns).
    """
    robot, plane_arrays = scene.robot, {}
    for moment in MOMENTS:
        limbs = _evaluate_limbs(scene, guess, moment)
        rotation = rotation_world_body(limbs.rpy)  # (M, N, 3, 3)
        points = joint_points_body(robot, limbs.angles)  # (M, N, 4, 3)
        points = limbs.com[..., None, :] + np.einsum("mnab,mnkb->mnka", rotation, points)
        planes = [
            find_separating_planes(solid, points[:, :, :-1], points[:, :, 1:])
            for solid in scene.terrain.obstacles
        ]
        columns = np.stack(planes, axis=1) if planes else np.zeros((len(points), 0, 4))
        plane_arrays[f"planes_{moment.name}"] = np.swapaxes(
            columns.reshape(len(points), -1, 4), 1, 2
        )
    return plane_arrays


def _build_pins(scene: ClimbScene, guess: Guess) -> dict[str, Array]:
    """Return the fixed choices of every round, (M, rows, columns) each."""
    terrain, region = scene.terrain, guess.rounds.region
    m = len(region) - 1
    chosen_regions = zip(terrain.free_choices, guess.free_regions.T, strict=True)
    region_rows = [
        np.zeros((m, 4, 0)),
        *(_pad_halfspaces(choice)[index] for choice, index in chosen_regions),
    ]
    halfspaces = np.concatenate(region_rows, axis=-1)
    pins = {
        "free_rows": halfspaces[:, :3],
        "free_bounds": halfspaces[:, 3:],
        **_build_planes(scene, guess),
    }
    if terrain.is_curved:
        return pins
    old, new = region[:-1], region[1:]  # (M, N)
    normal = np.stack([contact_region.normal for contact_region in terrain.regions])
    offset = np.array([contact_region.offset for contact_region in terrain.regions])
    edges = _pad_halfspaces(scene.standing)[new]  # (M, N, 4, edges)
    return pins | {
        "old_normal": np.swapaxes(normal[old], 1, 2),
        "normal": np.swapaxes(normal[new], 1, 2),
        "offset": offset[new][:, None],
        "edge_rows": np.swapaxes(edges[:, :, :3], 1, 2).reshape(m, 3, -1),
        "edge_bounds": np.swapaxes(edges[:, :, 3], 1, 2),
    }


def _pad_halfspaces(regions: Sequence[Region | FreeRegion]) -> Array:
    """Return rows and bounds (R, 4, max rows) of regions; padding rows are 0 x <= 1."""
    table = np.zeros((len(regions), 4, max(len(region.b) for region in regions)))
    table[:, 3] = 1.0  # 0 x <= 1
    for rows, region in zip(table, regions, strict=True):
        rows[:, : len(region.b)] = np.vstack([region.A.T, region.b])
    return table


def build_variable_bounds(scene: ClimbScene, joint_margin: float) -> tuple[Array, Array]:
    """Return lower and upper bounds of all variables.

    They are rotation limits, joint bounds tightened by joint_margin [rad], and the extent of a
    tube.
    """
    shape, robot = build_shape(scene), scene.robot
    limit = np.full(3, np.deg2rad(scene.spec.posture.rotation_limit_deg))
    limit[1] = min(limit[1], _PITCH_LIMIT)
    if shape.is_curved:
        limit[2] = np.inf  # a tube looks the same from all sides
    level = np.array([0.0, 0.0, scene.start.rpy[2]])  # a world turned about z changes nothing
    low, high = {"rpy": (level - limit)[:, None]}, {"rpy": (level + limit)[:, None]}
    low |= dict.fromkeys(("com", "toes"), np.full((3, 1), -np.inf))
    high |= dict.fromkeys(("com", "toes"), np.full((3, 1), np.inf))
    wall = scene.terrain.surfaces[0]
    if isinstance(wall, Tube):
        low["toes"] = np.array([[-np.inf], [-np.inf], [wall.lower]])
        high["toes"] = np.array([[np.inf], [np.inf], [wall.upper]])
    margin = joint_margin * robot.joint_unit.T
    for moment in MOMENTS:
        # Joints that a limb does not have stay at zero
        has_joint = robot.has_joint.T
        low[f"angles_{moment.name}"] = np.where(has_joint, robot.joint_lower.T + margin, 0.0)
        high[f"angles_{moment.name}"] = np.where(has_joint, robot.joint_upper.T - margin, 0.0)
    layout = build_variable_layout(shape.limbs, robot.joint_count)
    lower, upper = (np.tile(layout.pack(side), shape.num_rounds) for side in (low, high))
    return lower, upper


@dataclass(frozen=True)
class _LimbStates:
    """All limbs at one moment of every round, each with the body pose at that moment."""

    com: Array  # (M, N, 3)
    rpy: Array  # (M, N, 3)
    angles: Array  # (M, N, J)


def _evaluate_limbs(scene: ClimbScene, guess: Guess, moment: Moment) -> _LimbStates:
    """Return poses and joint angles of a guess, knee up where inverse kinematics fails."""
    rounds, n = guess.rounds, scene.robot.limb_count
    fraction = np.ones(n)
    if not moment.at_end:
        fraction[list(scene.gait)] = np.arange(n) / n
    com, rpy = interpolate_poses(rounds, fraction)
    rows = slice(1, None) if moment.at_new_contact else slice(None, -1)
    toes, region = rounds.toes[rows].copy(), rounds.region[rows]
    if moment.is_lifted:
        for j, i in np.ndindex(*region.shape):
            normal = scene.terrain.surfaces[region[j, i]].normal_at(toes[j, i])
            toes[j, i] += scene.spec.trajectory.swing_clearance * normal
    toes_body = np.einsum("mnba,mnb->mna", rotation_world_body(rpy), toes - com)
    solution = solve_inverse_kinematics(scene.robot, toes_body)
    angles = np.where(solution.valid[..., None], solution.best(), solution.angles[..., 0, :, :])
    return _LimbStates(com, rpy, angles)


def build_initial_point(scene: ClimbScene, guess: Guess, bounds: tuple[Array, Array]) -> Array:
    """Return all variables at a guess; joint angles follow by inverse kinematics, clipped to the
    bounds.
    """
    rounds = guess.rounds
    values = {
        "com": rounds.com[1:, :, None],
        "rpy": rounds.rpy[1:, :, None],
        "toes": np.swapaxes(rounds.toes[1:], 1, 2),
    }
    for moment in MOMENTS:
        angles = _evaluate_limbs(scene, guess, moment).angles
        values[f"angles_{moment.name}"] = np.swapaxes(angles, 1, 2)
    layout = build_variable_layout(scene.robot.limb_count, scene.robot.joint_count)
    return layout.pack(values).ravel().clip(*bounds)


def extract_rounds(scene: ClimbScene, guess: Guess, x: Array) -> Rounds:
    """Return the postures of a solution vector, with toes projected exactly onto their regions."""
    start, layout = (
        scene.start,
        build_variable_layout(scene.robot.limb_count, scene.robot.joint_count),
    )
    arrays = layout.unpack(np.reshape(x, (-1, layout.size)))
    toes = np.concatenate([start.toes[None], np.swapaxes(arrays["toes"], 1, 2)])
    project_onto_surfaces(scene, toes, guess.rounds.region)
    return Rounds(
        com=np.concatenate([start.com[None], arrays["com"][..., 0]]),
        rpy=np.concatenate([start.rpy[None], arrays["rpy"][..., 0]]),
        toes=toes,
        region=guess.rounds.region,
    )


def project_onto_surfaces(scene: ClimbScene, toes: Array, region: IntArray) -> None:
    """Project toes (M+1, N, 3) onto their surfaces, in place, except those of the start."""
    for j, limb in np.ndindex(*region[1:].shape):
        surface = scene.terrain.surfaces[region[j + 1, limb]]
        toes[j + 1, limb] = surface.project(toes[j + 1, limb])
