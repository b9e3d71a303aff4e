"""Data of the complementarity program for one scene: parameters and bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.scene.climb_scene import compute_load_wrench
from climbplan.climb.transition.complementarity import (
    MAX_LOAD,
    POINTS,
    ComplementarityDimensions,
    ComplementarityProgram,
    compile_complementarity_program,
)
from climbplan.climb.transition.round_constraints import (
    build_joint_row_bounds,
    build_robot_parameters,
    compute_first_pose_bounds,
    compute_joint_limits,
    convert_to_columns,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import compute_step_limits
from climbplan.mechanics.friction import contact_frame
from climbplan.program.staged_program import StagedProgram
from climbplan.reformulations.nlp_form import Bounds
from climbplan.robots.kinematics import to_body
from climbplan.robots.symbolic_robot import build_symbolic_limbs
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region

_JOINT_ROOM, _TORQUE_ROOM = 0.02, 0.02
_FLOOR_ROOM = 0.02  # [m] between the body and the lowest place
_IN_FRONT = 1e-9  # [m]


@dataclass(frozen=True)
class ComplementarityData:
    """The program of one scene with all its data."""

    scene: TransitionScene
    program: ComplementarityProgram
    surfaces: IntArray  # (N, S)
    parameters: dict[str, Array]
    lower: Array
    upper: Array

    @property
    def shape(self) -> ComplementarityDimensions:
        """The dimensions of the program."""
        return self.program.shape

    def bounds(self, formulation: StagedProgram) -> Bounds:
        """Return the bounds of variables, and of the constraints of one of the statements."""
        return Bounds(
            self.lower, self.upper, *_build_row_bounds(self.scene, formulation, self.surfaces)
        )

    def value(self, name: str, v: Array) -> Array:
        """Return the variables of a point by name: (M, N, 3) toes, otherwise (M, d)."""
        values: Array = v[self.program.formulation.place(name)]
        return values.reshape(len(values), -1, 3) if name == "toe" else values


def build_complementarity_data(scene: TransitionScene) -> ComplementarityData:
    """Build the program of a scene; raise TypeError for surfaces that are not flat."""
    surfaces = list_surfaces(scene)
    program = compile_complementarity_program(_build_shape(scene, surfaces))
    bounds = _build_variable_bounds(scene, program)
    return ComplementarityData(
        scene, program, surfaces, _build_parameters(scene, program.shape, surfaces), *bounds
    )


def list_surfaces(scene: TransitionScene) -> IntArray:
    """List the flat surfaces (N, S) of each limb; limbs with fewer repeat their last."""
    allowed = [np.flatnonzero(row) for row in scene.terrain.allowed]
    max_count = max(len(r) for r in allowed)
    return np.array([np.pad(r, (0, max_count - len(r)), mode="edge") for r in allowed], np.int64)


def _require_regions(scene: TransitionScene) -> tuple[Region, ...]:
    regions = scene.terrain.regions
    if len(regions) != len(scene.terrain.surfaces):
        raise TypeError("transitions stand on flat surfaces")
    return regions


def _find_bounding_surfaces(scene: TransitionScene) -> BoolArray:
    """Find surfaces (R,) with all other surfaces and postures in front of their planes."""
    regions = _require_regions(scene)
    points = np.concatenate([r.material for r in regions] + [scene.start.toes, scene.goal.toes])
    solids = [s.vertices for s in scene.terrain.obstacles]
    points = np.concatenate([points, *solids])
    behind = [(r.normal, r.offset - r.standoff - _IN_FRONT) for r in regions]
    return np.array([bool((points @ normal >= offset).all()) for normal, offset in behind])


def _list_solids(scene: TransitionScene) -> list[Solid]:
    """List solids that toes avoid, except those behind surfaces that bound all free space."""
    behind = zip(_require_regions(scene), _find_bounding_surfaces(scene), strict=True)
    tops = np.asarray(
        scene.terrain.stood_upon.any(axis=0)
    )  # obstacles reach as deep as the slab of their top
    covered = {s.name for s, top in zip(scene.terrain.obstacles, tops, strict=True) if top}
    slabs = [r.slab() for r, bounds in behind if not bounds and r.name not in covered]
    return [*scene.terrain.obstacles, *slabs]


def _build_shape(scene: TransitionScene, surfaces: IntArray) -> ComplementarityDimensions:
    solids = _list_solids(scene)
    polygons = not _find_bounding_surfaces(scene).all()
    return ComplementarityDimensions(
        rounds=scene.spec.task.rounds,
        kinematics=build_symbolic_limbs(scene.robot),
        surfaces=surfaces.shape[1],
        edges=max((len(r.b) for r in _require_regions(scene)), default=0) if polygons else 0,
        solids=len(solids),
        faces=max((len(s.b) for s in solids), default=0),
    )


def _build_parameters(
    scene: TransitionScene, shape: ComplementarityDimensions, surfaces: IntArray
) -> dict[str, Array]:
    regions, empty = _require_regions(scene), np.empty(0)
    surfaces_used = [regions[index] for index in surfaces.ravel()]
    edges = [_pad_rows(r.A, r.b, shape.edges) for r in surfaces_used]
    faces = [_pad_rows(s.A, s.b, shape.faces) for s in _list_solids(scene)]
    start = to_body(scene.start.com, scene.start.rpy, scene.start.toes)
    toe_values = shape.kinematics.at_toes(scene.robot, start)
    parameters = {
        # rows of the frame are the columns of the program
        "axes": np.array([contact_frame(r.normal).axes for r in surfaces_used]),
        "offset": np.array([r.offset for r in surfaces_used]),
        "bounds_room": _find_bounding_surfaces(scene)[surfaces.ravel()].astype(float),
        "edge_row": np.array([a for a, _ in edges]),
        "edge_end": np.array([b for _, b in edges]),
        "face_row": np.concatenate([empty, *(a.ravel() for a, _ in faces)]),
        "face_end": np.concatenate([empty, *(b for _, b in faces)]),
        "mu": np.array([r.friction for r in surfaces_used]) / scene.spec.force.safety_friction,
        "load": compute_load_wrench(scene.spec, scene.robot, scene.start.rpy) / scene.robot.weight,
        # Limbs stay bent as they are at the start
        **{
            name: np.tile(toe_values[name].ravel(), POINTS)
            for name in shape.kinematics.parameter_shapes
        },
    }
    return {**build_robot_parameters(scene, scene.start.toes), **convert_to_columns(parameters)}


def _pad_rows(a: Array, b: Array, count: int) -> tuple[Array, Array]:
    """Pad rows by repetition up to a count; a count of zero returns none."""
    if count == 0:
        return a[:0], b[:0]
    index = np.minimum(np.arange(count), len(b) - 1)
    return a[index], b[index]


def _build_variable_bounds(
    scene: TransitionScene, program: ComplementarityProgram
) -> tuple[Array, Array]:
    """Build the bounds of variables; goal toes are fixed."""
    spec, m = scene.spec, program.shape.rounds
    corners = np.concatenate([s.vertices for s in _require_regions(scene)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    body = np.stack([scene.start.com, scene.goal.com])
    max_rotation = np.full(3, np.deg2rad(spec.posture.rotation_limit_deg))
    freedom = spec.posture.steps.com_max / 2
    floor = scene.robot.body_hull[:, 2].min()
    min_position = np.maximum(
        body.min(axis=0) - freedom, [-np.inf, -np.inf, low[2] - floor + _FLOOR_ROOM]
    )
    min_position = np.minimum(min_position, body.min(axis=0))
    pose_lower = np.tile(np.concatenate([min_position, -max_rotation]), (m, 1))
    pose_upper = np.tile(np.concatenate([body.max(axis=0) + freedom, max_rotation]), (m, 1))
    pose_lower[0], pose_upper[0] = compute_first_pose_bounds(scene)
    limbs, contacts = program.shape.limbs, program.shape.limbs * program.shape.surfaces
    toe_lower, toe_upper = np.tile(low, (m, limbs)), np.tile(high, (m, limbs))
    toe_lower[-1] = toe_upper[-1] = scene.goal.toes.ravel()
    min_force = np.tile([0.0, -MAX_LOAD, -MAX_LOAD], contacts)
    max_torque_use = (1 - _TORQUE_ROOM) / spec.force.safety_torque
    limits: dict[str, tuple[ArrayLike, ArrayLike]] = {
        "pose": (pose_lower, pose_upper),
        "toe": (toe_lower, toe_upper),
        "force": (min_force, MAX_LOAD),
        "hold": (0.0, 1.0),
        "face_weight": (0.0, 1.0),
        "s": (0.0, max_torque_use),
    }
    if "angles" in program.shape.kinematics.variable_shapes:
        low_angle, high_angle = compute_joint_limits(scene.robot, _JOINT_ROOM)
        limits["angles"] = np.tile(low_angle.ravel(), POINTS), np.tile(high_angle.ravel(), POINTS)
    if "pull" in program.shape.kinematics.variable_shapes:
        limits["pull"] = -np.inf, np.inf
    point = program.formulation.point
    return point({k: b[0] for k, b in limits.items()}), point({k: b[1] for k, b in limits.items()})


def _build_row_bounds(
    scene: TransitionScene, formulation: StagedProgram, surfaces: IntArray
) -> tuple[Array, Array]:
    """Build the bounds of a statement's constraints, the same in each round."""
    in_front = np.where(_find_bounding_surfaces(scene)[surfaces.ravel()], -_IN_FRONT, -np.inf)
    joints = build_joint_row_bounds(scene.robot, _JOINT_ROOM, POINTS)
    rows = {"transition.joints": joints} if "transition.joints" in formulation.sizes() else {}
    return formulation.replace_row_bounds(
        {
            **rows,
            "contact.distance": (in_front, np.inf),
            "switch.supporting": (
                scene.spec.task.min_supporting_limbs,
                scene.robot.limb_count - 1.0,
            ),
            "force.command": build_joint_row_bounds(scene.robot, _JOINT_ROOM / 2),
            "steps.toe": (-np.inf, compute_step_limits(scene) ** 2),
            "steps.com": (-np.inf, scene.spec.posture.steps.com_max**2),
        }
    )


def compute_dependent_variables(
    scene: TransitionScene, pose: Array, toe: Array
) -> dict[str, Array]:
    """Compute start values (M, d) of limb variables for poses (M, 6) and toes (M, N, 3)."""
    limbs = build_symbolic_limbs(scene.robot)
    if not limbs.variable_shapes:
        return {}
    before = np.concatenate([scene.start.toes[None], toe[:-1]])
    both = np.stack([to_body(pose[:, :3], pose[:, 3:], toes) for toes in (before, toe)], axis=1)
    values = limbs.at_toes(scene.robot, both)
    return {name: values[name].reshape(len(pose), -1) for name in limbs.variable_shapes}
