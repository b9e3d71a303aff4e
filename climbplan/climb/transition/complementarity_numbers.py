"""Parameters and bounds of the complementarity program for one scene."""

from __future__ import annotations

import numpy as np

from climbplan.climb.plan.climb_plan import Array, Index, Mask
from climbplan.climb.scene import load_wrench
from climbplan.climb.transition.complementarity import MOST_LOAD, ComplementarityProgram, Shape
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import toe_step_limits
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.stiffness import joint_softness
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Region

_JOINT_ROOM, _STRETCH_ROOM, _TORQUE_ROOM = 0.02, 1e-3, 0.02
_FLOOR_ROOM = 0.02  # [m] between the body and the lowest place
_IN_FRONT = 1e-9  # [m]


def surfaces_of(scene: TransitionScene) -> Index:
    """(N, S) flat surfaces of each limb; limbs with fewer repeat their last."""
    own = [np.flatnonzero(row) for row in scene.terrain.allowed]
    most = max(len(r) for r in own)
    return np.array([np.pad(r, (0, most - len(r)), mode="edge") for r in own], np.int64)


def _regions(scene: TransitionScene) -> tuple[Region, ...]:
    regions = scene.terrain.regions
    if len(regions) != len(scene.terrain.surfaces):
        raise TypeError("transitions stand on flat surfaces")
    return regions


def _bounds_room(scene: TransitionScene) -> Mask:
    """(R,) whether all other surfaces and postures are in front of a surface's plane."""
    regions = _regions(scene)
    points = np.concatenate([r.vertices for r in regions] + [scene.start.toes, scene.goal.toes])
    solids = [s.vertices for s in scene.terrain.obstacles]
    points = np.concatenate([points, *solids])
    return np.array([bool((points @ r.normal >= r.offset - _IN_FRONT).all()) for r in regions])


def _solids(scene: TransitionScene) -> list[Solid]:
    """What toes keep out of, other than by being in front of surfaces that bound the room."""
    behind = zip(_regions(scene), _bounds_room(scene), strict=True)
    tops = np.asarray(
        scene.terrain.stood_upon.any(axis=0)
    )  # obstacles reach as deep as the slab of their top
    known = {s.name for s, top in zip(scene.terrain.obstacles, tops, strict=True) if top}
    slabs = [r.slab() for r, bounds in behind if not bounds and r.name not in known]
    return [*scene.terrain.obstacles, *slabs]


def shape_of(scene: TransitionScene, surfaces: Index) -> Shape:
    """The shape of the program of a scene."""
    solids = _solids(scene)
    polygons = [
        r for r, bounds in zip(_regions(scene), _bounds_room(scene), strict=True) if not bounds
    ]
    return Shape(
        rounds=scene.spec.task.rounds,
        limbs=scene.robot.limb_count,
        surfaces=surfaces.shape[1],
        edges=max((len(r.b) for r in _regions(scene)), default=0) if polygons else 0,
        solids=len(solids),
        faces=max((len(s.b) for s in solids), default=0),
    )


def numbers_of(scene: TransitionScene, program: ComplementarityProgram, surfaces: Index) -> Array:
    """All numbers of the program, a penalty of zero last."""
    robot, weights, shape = scene.robot, scene.spec.posture.weights, program.shape
    regions, bounds = _regions(scene), _bounds_room(scene)
    used = [regions[index] for index in surfaces.ravel()]
    own = {
        "first_toe": scene.start.toes.ravel(),
        "last_pose": np.concatenate([scene.goal.com, scene.goal.rpy]),
        "shoulder": robot.shoulder_body.ravel(),
        "links": robot.link_lengths.ravel(),
        "mount_yaw": robot.mount_yaw,
        "middle": (robot.joint_lower[:, 0] + robot.joint_upper[:, 0]) / 2,
        "torque_limit": (robot.max_torque / robot.weight).ravel(),
        "softness": (joint_softness(robot) * robot.weight).ravel(),
        # rows of the frame are the columns of the program
        "axes": np.array([contact_frame(r.normal).axes for r in used]).ravel(),
        "offset": np.array([r.offset for r in used]),
        "bounds_room": bounds[surfaces.ravel()].astype(float),
        "mu": np.array([r.friction for r in used]) / scene.spec.force.safety_friction,
        "load": load_wrench(scene.spec, robot, scene.start.rpy) / robot.weight,
        "least_load": np.array([scene.spec.search.least_load]),
        "weights": np.array([weights.com, weights.rotation, weights.toe, weights.effort]),
        "penalty": np.zeros(1),
    }
    edges = [_padded(r.A, r.b, shape.edges) for r in used]
    own["edge_row"] = np.concatenate([a.ravel() for a, _ in edges])
    own["edge_end"] = np.concatenate([b for _, b in edges])
    faces = [_padded(s.A, s.b, shape.faces) for s in _solids(scene)]
    own["face_row"] = np.concatenate([np.empty(0), *(a.ravel() for a, _ in faces)])
    own["face_end"] = np.concatenate([np.empty(0), *(b for _, b in faces)])
    return np.concatenate([own[name] for name in program.numbers.names])


def _padded(a: Array, b: Array, count: int) -> tuple[Array, Array]:
    """Rows repeated up to a count, all left out for a count of zero."""
    if count == 0:
        return a[:0], b[:0]
    index = np.minimum(np.arange(count), len(b) - 1)
    return a[index], b[index]


def variable_bounds(scene: TransitionScene, program: ComplementarityProgram) -> tuple[Array, Array]:
    """Bounds of all variables; what is given is fixed."""
    shape, spec = program.shape, scene.spec
    n, forces = shape.limbs, shape.limbs * shape.surfaces
    corners = np.concatenate([s.vertices for s in _regions(scene)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    body = np.stack([scene.start.com, scene.goal.com])
    turn = np.full(3, np.deg2rad(spec.posture.rotation_limit_deg))
    span = spec.posture.steps.com_max / 2
    floor = scene.robot.body_hull[:, 2].min()
    least = np.maximum(body.min(axis=0) - span, [-np.inf, -np.inf, low[2] - floor + _FLOOR_ROOM])
    least = np.minimum(least, body.min(axis=0))
    largest = (1 - _TORQUE_ROOM) / spec.force.safety_torque
    sides = n * shape.solids * shape.faces
    lowers, uppers = [], []
    for j in range(shape.rounds):
        first, last = j == 0, j + 1 == shape.rounds
        start = np.concatenate([scene.start.com, scene.start.rpy])
        push = np.tile([0.0, -MOST_LOAD, -MOST_LOAD], forces)
        goal = scene.goal.toes.ravel()
        lower = {
            "pose": start if first else np.concatenate([least, -turn]),
            "toe": goal if last else np.tile(low, n),
            "force": push,
            "hold": np.zeros(n),
            "side": np.zeros(sides),
            "s": np.zeros(1),
        }
        upper = {
            "pose": start if first else np.concatenate([body.max(axis=0) + span, turn]),
            "toe": goal if last else np.tile(high, n),
            "force": np.full(3 * forces, MOST_LOAD),
            "hold": np.ones(n),
            "side": np.ones(sides),
            "s": np.array([largest]),
        }
        lowers += [lower[name] for name in program.variables.names]
        uppers += [upper[name] for name in program.variables.names]
    return np.concatenate(lowers), np.concatenate(uppers)


def row_bounds(
    scene: TransitionScene, program: ComplementarityProgram, surfaces: Index
) -> tuple[Array, Array]:
    """Bounds of all rows."""
    robot, n = scene.robot, program.shape.limbs
    least = scene.spec.task.supporting
    joints = np.repeat(robot.joint_lower + _JOINT_ROOM, 2, axis=0).ravel()
    joints_up = np.repeat(robot.joint_upper - _JOINT_ROOM, 2, axis=0).ravel()
    in_front = np.where(_bounds_room(scene)[surfaces.ravel()], -_IN_FRONT, -np.inf)
    inf = np.inf
    fixed: dict[str, tuple[Array | float, Array | float]] = {
        "contact.distance": (in_front, inf),
        "switch.load": (-inf, 0.0),
        "switch.supporting": (float(least), n - 1.0),
        "solid.outside": (0.0, inf),
        "solid.sides": (1.0, 1.0),
        "force.friction": (-inf, 0.0),
        "force.torque": (-inf, 0.0),
        "force.command": (
            (robot.joint_lower + _JOINT_ROOM / 2).ravel(),
            (robot.joint_upper - _JOINT_ROOM / 2).ravel(),
        ),
        "force.equilibrium": (0.0, 0.0),
        "transition.reach": (-1 + _STRETCH_ROOM, 1 - _STRETCH_ROOM),
        "transition.joints": (joints, joints_up),
        "steps.toe": (-inf, toe_step_limits(scene) ** 2),
        "steps.com": (-inf, scene.spec.posture.steps.com_max**2),
    }
    lower = [np.broadcast_to(fixed[name][0], (size,)) for name, size in program.kinds]
    upper = [np.broadcast_to(fixed[name][1], (size,)) for name, size in program.kinds]
    m = program.shape.rounds
    return np.tile(np.concatenate(lower), m), np.tile(np.concatenate(upper), m)


def parts_of(program: ComplementarityProgram, v: Array) -> list[dict[str, Array]]:
    """The matrices of each round in a point."""
    each = v.reshape(program.shape.rounds, program.variables.size)
    return [program.variables.unpack(own) for own in each]
