"""The program that finds its own sequence on one scene: parameters and bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.scene.climb_scene import load_wrench
from climbplan.climb.transition.complementarity import (
    MOST_LOAD,
    POINTS,
    ComplementarityProgram,
    Shape,
    complementarity_program,
)
from climbplan.climb.transition.round_rows import (
    as_columns,
    first_ends,
    joint_bounds,
    joint_ends,
    robot_numbers,
)
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import toe_step_limits
from climbplan.mechanics.friction import contact_frame
from climbplan.program.trajectory import Trajectory
from climbplan.reformulations.nlp_form import Bounds
from climbplan.robots.kinematics import to_body
from climbplan.robots.stated_robot import stated_limbs
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region

_JOINT_ROOM, _TORQUE_ROOM = 0.02, 0.02
_FLOOR_ROOM = 0.02  # [m] between the body and the lowest place
_IN_FRONT = 1e-9  # [m]


@dataclass(frozen=True)
class FreeMotion:
    """One scene's program with all its numbers."""

    scene: TransitionScene
    program: ComplementarityProgram
    surfaces: IntArray  # (N, S)
    parameters: dict[str, Array]
    lower: Array
    upper: Array

    @property
    def shape(self) -> Shape:
        """What the program is built for."""
        return self.program.shape

    def bounds(self, stated: Trajectory) -> Bounds:
        """Of variables, and of the rows of one of the program's statements."""
        return Bounds(self.lower, self.upper, *_row_bounds(self.scene, stated, self.surfaces))

    def value(self, name: str, v: Array) -> Array:
        """Variables of a point by name: (M, N, 3) toes, otherwise (M, d)."""
        found: Array = v[self.program.stated.place(name)]
        return found.reshape(len(found), -1, 3) if name == "toe" else found


def free_motion(scene: TransitionScene) -> FreeMotion:
    """The program of a scene; raises TypeError for surfaces that are not flat."""
    surfaces = surfaces_of(scene)
    program = complementarity_program(_shape_of(scene, surfaces))
    bounds = _variable_bounds(scene, program)
    return FreeMotion(scene, program, surfaces, _numbers(scene, program.shape, surfaces), *bounds)


def surfaces_of(scene: TransitionScene) -> IntArray:
    """(N, S) flat surfaces of each limb; limbs with fewer repeat their last."""
    own = [np.flatnonzero(row) for row in scene.terrain.allowed]
    most = max(len(r) for r in own)
    return np.array([np.pad(r, (0, most - len(r)), mode="edge") for r in own], np.int64)


def _regions(scene: TransitionScene) -> tuple[Region, ...]:
    regions = scene.terrain.regions
    if len(regions) != len(scene.terrain.surfaces):
        raise TypeError("transitions stand on flat surfaces")
    return regions


def _bounds_room(scene: TransitionScene) -> BoolArray:
    """(R,) whether all other surfaces and postures are in front of a surface's plane."""
    regions = _regions(scene)
    points = np.concatenate([r.material for r in regions] + [scene.start.toes, scene.goal.toes])
    solids = [s.vertices for s in scene.terrain.obstacles]
    points = np.concatenate([points, *solids])
    behind = [(r.normal, r.offset - r.standoff - _IN_FRONT) for r in regions]
    return np.array([bool((points @ normal >= offset).all()) for normal, offset in behind])


def _solids(scene: TransitionScene) -> list[Solid]:
    """What toes keep out of, other than by being in front of surfaces that bound the room."""
    behind = zip(_regions(scene), _bounds_room(scene), strict=True)
    tops = np.asarray(
        scene.terrain.stood_upon.any(axis=0)
    )  # obstacles reach as deep as the slab of their top
    known = {s.name for s, top in zip(scene.terrain.obstacles, tops, strict=True) if top}
    slabs = [r.slab() for r, bounds in behind if not bounds and r.name not in known]
    return [*scene.terrain.obstacles, *slabs]


def _shape_of(scene: TransitionScene, surfaces: IntArray) -> Shape:
    solids = _solids(scene)
    polygons = not _bounds_room(scene).all()
    return Shape(
        rounds=scene.spec.task.rounds,
        stated=stated_limbs(scene.robot),
        surfaces=surfaces.shape[1],
        edges=max((len(r.b) for r in _regions(scene)), default=0) if polygons else 0,
        solids=len(solids),
        faces=max((len(s.b) for s in solids), default=0),
    )


def _numbers(scene: TransitionScene, shape: Shape, surfaces: IntArray) -> dict[str, Array]:
    regions, nothing = _regions(scene), np.empty(0)
    used = [regions[index] for index in surfaces.ravel()]
    edges = [_padded(r.A, r.b, shape.edges) for r in used]
    faces = [_padded(s.A, s.b, shape.faces) for s in _solids(scene)]
    start = to_body(scene.start.com, scene.start.rpy, scene.start.toes)
    at_start = shape.stated.at_toes(scene.robot, start)
    own = {
        # rows of the frame are the columns of the program
        "axes": np.array([contact_frame(r.normal).axes for r in used]),
        "offset": np.array([r.offset for r in used]),
        "bounds_room": _bounds_room(scene)[surfaces.ravel()].astype(float),
        "edge_row": np.array([a for a, _ in edges]),
        "edge_end": np.array([b for _, b in edges]),
        "face_row": np.concatenate([nothing, *(a.ravel() for a, _ in faces)]),
        "face_end": np.concatenate([nothing, *(b for _, b in faces)]),
        "mu": np.array([r.friction for r in used]) / scene.spec.force.safety_friction,
        "load": load_wrench(scene.spec, scene.robot, scene.start.rpy) / scene.robot.weight,
        # Limbs stay bent as they are at the start
        **{name: np.tile(at_start[name].ravel(), POINTS) for name in shape.stated.given},
    }
    return {**robot_numbers(scene, scene.start.toes), **as_columns(own)}


def _padded(a: Array, b: Array, count: int) -> tuple[Array, Array]:
    """Rows repeated up to a count, all left out for a count of zero."""
    if count == 0:
        return a[:0], b[:0]
    index = np.minimum(np.arange(count), len(b) - 1)
    return a[index], b[index]


def _variable_bounds(
    scene: TransitionScene, program: ComplementarityProgram
) -> tuple[Array, Array]:
    """What is given is fixed."""
    spec, m = scene.spec, program.shape.rounds
    corners = np.concatenate([s.vertices for s in _regions(scene)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    body = np.stack([scene.start.com, scene.goal.com])
    turn = np.full(3, np.deg2rad(spec.posture.rotation_limit_deg))
    span = spec.posture.steps.com_max / 2
    floor = scene.robot.body_hull[:, 2].min()
    least = np.maximum(body.min(axis=0) - span, [-np.inf, -np.inf, low[2] - floor + _FLOOR_ROOM])
    least = np.minimum(least, body.min(axis=0))
    pose_lower = np.tile(np.concatenate([least, -turn]), (m, 1))
    pose_upper = np.tile(np.concatenate([body.max(axis=0) + span, turn]), (m, 1))
    pose_lower[0], pose_upper[0] = first_ends(scene)
    limbs, contacts = program.shape.limbs, program.shape.limbs * program.shape.surfaces
    toe_lower, toe_upper = np.tile(low, (m, limbs)), np.tile(high, (m, limbs))
    toe_lower[-1] = toe_upper[-1] = scene.goal.toes.ravel()
    push = np.tile([0.0, -MOST_LOAD, -MOST_LOAD], contacts)
    largest = (1 - _TORQUE_ROOM) / spec.force.safety_torque
    both: dict[str, tuple[ArrayLike, ArrayLike]] = {
        "pose": (pose_lower, pose_upper),
        "toe": (toe_lower, toe_upper),
        "force": (push, MOST_LOAD),
        "hold": (0.0, 1.0),
        "face_weight": (0.0, 1.0),
        "s": (0.0, largest),
    }
    if "angles" in program.shape.stated.found:
        low_angle, high_angle = joint_ends(scene.robot, _JOINT_ROOM)
        both["angles"] = np.tile(low_angle.ravel(), POINTS), np.tile(high_angle.ravel(), POINTS)
    if "pull" in program.shape.stated.found:
        both["pull"] = -np.inf, np.inf
    point = program.stated.point
    return point({k: b[0] for k, b in both.items()}), point({k: b[1] for k, b in both.items()})


def _row_bounds(
    scene: TransitionScene, stated: Trajectory, surfaces: IntArray
) -> tuple[Array, Array]:
    """Of one of a program's statements, the same in each round."""
    in_front = np.where(_bounds_room(scene)[surfaces.ravel()], -_IN_FRONT, -np.inf)
    joints = joint_bounds(scene.robot, _JOINT_ROOM, POINTS)
    rows = {"transition.joints": joints} if "transition.joints" in stated.sizes() else {}
    return stated.bounded(
        {
            **rows,
            "contact.distance": (in_front, np.inf),
            "switch.supporting": (scene.spec.task.supporting, scene.robot.limb_count - 1.0),
            "force.command": joint_bounds(scene.robot, _JOINT_ROOM / 2),
            "steps.toe": (-np.inf, toe_step_limits(scene) ** 2),
            "steps.com": (-np.inf, scene.spec.posture.steps.com_max**2),
        }
    )


def found_at(scene: TransitionScene, pose: Array, toe: Array) -> dict[str, Array]:
    """Where variables of limbs start, (M, d), for poses (M, 6) and toes (M, N, 3) after rounds."""
    limbs = stated_limbs(scene.robot)
    if not limbs.found:
        return {}
    before = np.concatenate([scene.start.toes[None], toe[:-1]])
    both = np.stack([to_body(pose[:, :3], pose[:, 3:], toes) for toes in (before, toe)], axis=1)
    values = limbs.at_toes(scene.robot, both)
    return {name: values[name].reshape(len(pose), -1) for name in limbs.found}
