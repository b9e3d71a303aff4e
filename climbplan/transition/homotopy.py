"""The complementarity method: random starts, a homotopy each, then the motion planned anew.

What a homotopy ends with is rounded: which limbs hold in which round, and on which surface every
toe stands. The motion is planned again with that fixed, so that nothing of eps is left in a plan.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from climbplan.climb.scene import load_wrench
from climbplan.errors import UsageError
from climbplan.mechanics.friction import contact_frame
from climbplan.mechanics.stiffness import joint_softness
from climbplan.plans.climb_plan import Array, Index, Mask
from climbplan.solvers.interruption import interruptible
from climbplan.terrain.surfaces import Region
from climbplan.transition.complementarity import (
    HOMOTOPY,
    MOST_LOAD,
    ComplementarityProgram,
    Shape,
    complementarity_program,
)
from climbplan.transition.footholds import GOAL, START, Footholds, Poses, reach_of
from climbplan.transition.scene import TransitionScene
from climbplan.transition.search import Sequence, State, stance_of_move
from climbplan.transition.stances import Laboratory, stance_forces

_MOVED = 0.02  # [m] a shorter step is none
_JOINT_ROOM, _STRETCH_ROOM, _TORQUE_ROOM = 0.02, 1e-3, 0.02
_MOST_ASSIGNMENTS = 20_000  # looked through for a rounding
_REPAIRS = 8  # roundings whose motion is planned
_NOISE = 0.05  # [m] on random starts


Carry = Callable[[Laboratory, Sequence], str]


@dataclass(frozen=True)
class Start:
    """What became of one random start."""

    seed: int
    reason: str  # why there is no motion, empty if there is one
    repaired: bool  # the point itself did not round to a motion, one of its neighbours did
    seconds: float  # with what `carry` took
    iterations: int  # of the homotopy


def run_start(scene: TransitionScene, seed: int, carry: Carry, deadline: float = np.inf) -> Start:
    """One homotopy from a random start; deadline in `time.monotonic` seconds.

    carry: called with one rounding after the other until it returns no reason against it. Raises
    UsageError for terrain with boxes or obstacles: their free space is not convex.
    """
    begin = time.perf_counter()
    if scene.terrain.obstacles:
        raise UsageError(
            "method complementarity knows ground and walls only; with boxes or obstacles use "
            "enumerate"
        )
    surfaces = _surfaces(scene)
    shape = Shape(scene.spec.task.rounds, scene.robot.limb_count, surfaces.shape[1])
    program = complementarity_program(shape)
    numbers = _parameters(scene, program, surfaces)
    lower, upper = _variable_bounds(scene, program)
    v = np.clip(_random_start(scene, program, np.random.default_rng(seed)), lower, upper)
    iterations = 0
    program.deadline.at = deadline
    with interruptible(program.deadline.stop):
        for eps in HOMOTOPY:
            row_lower, row_upper = _row_bounds(scene, program, eps)
            answer = program.solver(
                x0=v, p=numbers, lbx=lower, ubx=upper, lbg=row_lower, ubg=row_upper
            )
            v = np.clip(np.array(answer["x"]).ravel(), lower, upper)
            iterations += int(program.solver.stats().get("iter_count", 0))
            if time.monotonic() > deadline:
                break
    reasons: list[str] = []
    for lab, sequence, repaired in _roundings(scene, program, v, surfaces):
        reason = carry(lab, sequence)
        if not reason:
            return Start(seed, "", repaired, time.perf_counter() - begin, iterations)
        reasons.append(reason)
    reason = reasons[0] if reasons else "no rounding has admissible forces"
    return Start(seed, reason, False, time.perf_counter() - begin, iterations)


def _surfaces(scene: TransitionScene) -> Index:
    """(N, S) flat surfaces of each limb; limbs with fewer repeat their last."""
    own = [np.flatnonzero(row) for row in scene.terrain.allowed]
    most = max(len(r) for r in own)
    return np.array([np.pad(r, (0, most - len(r)), mode="edge") for r in own], np.int64)


def _parameters(scene: TransitionScene, program: ComplementarityProgram, surfaces: Index) -> Array:
    robot, weights = scene.robot, scene.spec.posture.weights
    axes, offsets, mu = [], [], []
    for index in surfaces.ravel():
        surface = scene.terrain.surfaces[index]
        if not isinstance(surface, Region):
            raise TypeError("transitions stand on flat surfaces")
        axes.append(contact_frame(surface.normal).axes)  # rows: the columns of the program
        offsets.append(surface.offset)
        mu.append(surface.friction / scene.spec.force.safety_friction)
    own = {
        "first_toe": scene.start.toes.ravel(),
        "last_pose": np.concatenate([scene.goal.com, scene.goal.rpy]),
        "shoulder": robot.shoulder_body.ravel(),
        "links": robot.link_lengths.ravel(),
        "mount_yaw": robot.mount_yaw,
        "middle": (robot.joint_lower[:, 0] + robot.joint_upper[:, 0]) / 2,
        "torque_limit": (robot.max_torque / robot.weight).ravel(),
        "softness": (joint_softness(robot) * robot.weight).ravel(),
        "axes": np.array(axes).ravel(),
        "offset": np.array(offsets),
        "mu": np.array(mu),
        "load": load_wrench(scene.spec, robot, scene.start.rpy) / robot.weight,
        "least_load": np.array([scene.spec.search.least_load]),
        "weights": np.array([weights.com, weights.rotation, weights.toe, weights.effort]),
    }
    return np.concatenate([own[name] for name, *_ in program.numbers.names])


def _variable_bounds(
    scene: TransitionScene, program: ComplementarityProgram
) -> tuple[Array, Array]:
    shape, spec = program.shape, scene.spec
    n, forces = shape.limbs, shape.limbs * shape.surfaces
    corners = np.concatenate([s.vertices for s in scene.terrain.regions])
    low, high = corners.min(axis=0), corners.max(axis=0)
    body = np.stack([scene.start.com, scene.goal.com])
    turn = np.full(3, np.deg2rad(spec.posture.rotation_limit_deg))
    span = spec.posture.steps.com_max / 2
    floor = scene.robot.body_hull[:, 2].min()
    least = np.maximum(body.min(axis=0) - span, [-np.inf, -np.inf, low[2] - floor + 0.02])
    lowers, uppers = [], []
    for j in range(shape.rounds):
        pose_low = np.concatenate([least, -turn])
        pose_high = np.concatenate([body.max(axis=0) + span, turn])
        toe_low, toe_high = np.tile(low, n), np.tile(high, n)
        if j == 0:
            pose_low = pose_high = np.concatenate([scene.start.com, scene.start.rpy])
        if j + 1 == shape.rounds:
            toe_low = toe_high = scene.goal.toes.ravel()
        push = np.tile([0.0, -MOST_LOAD, -MOST_LOAD], forces)
        largest = (1 - _TORQUE_ROOM) / spec.force.safety_torque
        lowers.append(np.concatenate([pose_low, toe_low, push, np.zeros(n), [0.0]]))
        uppers.append(
            np.concatenate(
                [pose_high, toe_high, np.full(3 * forces, MOST_LOAD), np.ones(n), [largest]]
            )
        )
    return np.concatenate(lowers), np.concatenate(uppers)


def _row_bounds(
    scene: TransitionScene, program: ComplementarityProgram, eps: float
) -> tuple[Array, Array]:
    robot, n = scene.robot, program.shape.limbs
    least = scene.spec.task.supporting
    joints = np.repeat(robot.joint_lower + _JOINT_ROOM, 2, axis=0).ravel()
    joints_up = np.repeat(robot.joint_upper - _JOINT_ROOM, 2, axis=0).ravel()
    inf = np.inf
    fixed: dict[str, tuple[Array | float, Array | float]] = {
        "contact.distance": (-1e-9, inf),
        "contact.complementarity": (-inf, eps),
        "contact.placed": (-inf, eps),
        "switch.complementarity": (-inf, eps),
        "switch.binary": (-inf, eps),
        "switch.load": (-inf, 0.0),
        "switch.supporting": (float(least), float(n)),
        "force.friction": (-inf, 0.0),
        "force.torque": (-inf, 0.0),
        "force.command": (
            (robot.joint_lower + _JOINT_ROOM / 2).ravel(),
            (robot.joint_upper - _JOINT_ROOM / 2).ravel(),
        ),
        "force.equilibrium": (0.0, 0.0),
        "transition.reach": (-1 + _STRETCH_ROOM, 1 - _STRETCH_ROOM),
        "transition.joints": (joints, joints_up),
    }
    lower = [np.broadcast_to(fixed[name][0], (size,)) for name, size in program.kinds]
    upper = [np.broadcast_to(fixed[name][1], (size,)) for name, size in program.kinds]
    m = program.shape.rounds
    return np.tile(np.concatenate(lower), m), np.tile(np.concatenate(upper), m)


def _random_start(
    scene: TransitionScene, program: ComplementarityProgram, rng: np.random.Generator
) -> Array:
    """Poses and toes somewhere on their ways, holds and pressures at random."""
    shape = program.shape
    n, forces, m = shape.limbs, shape.limbs * shape.surfaces, shape.rounds
    start, goal = scene.start, scene.goal
    out = []
    share = np.sort(rng.uniform(0.0, 1.0, (m + 1, n)), axis=0)[1:, :, None]
    for j in range(m):
        part = j / m
        com = start.com + part * (goal.com - start.com) + _NOISE * rng.uniform(-1, 1, 3)
        rpy = start.rpy + part * (goal.rpy - start.rpy) + _NOISE * rng.uniform(-1, 1, 3)
        toes = start.toes + share[j] * (goal.toes - start.toes)
        toes = toes + _NOISE * rng.uniform(-1, 1, toes.shape)
        force = np.zeros((forces, 3))
        force[:, 0] = rng.uniform(0.0, 0.5, forces)
        out.append(
            np.concatenate([com, rpy, toes.ravel(), force.ravel(), rng.uniform(0.2, 0.8, n), [0.3]])
        )
    return np.concatenate(out)


def _roundings(
    scene: TransitionScene, program: ComplementarityProgram, v: Array, surfaces: Index
) -> Iterator[tuple[Laboratory, Sequence, bool]]:
    """Sequences close to a point: as it has them, then those nearest of limbs that move once.

    The latter, which count as repaired, only where stances find admissible forces at the point's
    poses.
    """
    m = program.shape.rounds
    parts = [_parts(program, own) for own in v.reshape(m, program.variables.size)]
    toes = np.stack([scene.start.toes, *(p["toe"].T for p in parts)])  # (M + 1, N, 3)
    hold = np.stack([p["hold"][0] for p in parts])  # (M, N)
    step = np.linalg.norm(np.diff(toes, axis=0), axis=-1)
    moved = (hold < 0.5) & (step > _MOVED)
    far = np.linalg.norm(scene.goal.toes - scene.start.toes, axis=1) > _MOVED
    poses = Poses(
        np.stack([*(p["pose"][:3, 0] for p in parts), scene.goal.com]),
        np.stack([*(p["pose"][3:, 0] for p in parts), scene.goal.rpy]),
    )
    lab = _laboratory(scene, toes, poses, surfaces)
    most = scene.robot.limb_count - scene.spec.task.supporting
    counts = moved.sum(axis=1)
    if counts.min() > 0 and counts.max() <= most and (moved.any(axis=0) >= far).all():
        yield lab, Sequence(_states(moved), tuple(range(m + 1)), 0.0, np.inf), False
    yield from _nearest(lab, hold, far, most)


def _nearest(
    lab: Laboratory, hold: Array, far: Mask, most: int
) -> Iterator[tuple[Laboratory, Sequence, bool]]:
    """Sequences in which every limb moves once, those nearest to the holds (M, N) first."""
    m = len(hold)
    limbs = np.flatnonzero(far)
    if m ** len(limbs) > _MOST_ASSIGNMENTS:
        return
    rounds = np.array(list(itertools.product(range(m), repeat=len(limbs))))  # (A, limbs)
    counts = (rounds[:, None, :] == np.arange(m)[:, None]).sum(axis=2)  # (A, M)
    rounds = rounds[(counts >= 1).all(axis=1) & (counts <= most).all(axis=1)]
    away = hold[rounds, limbs].sum(axis=1)  # a limb that moves ought not to hold
    rounds = rounds[np.argsort(away, kind="stable")]
    moved = np.zeros((len(rounds), m, hold.shape[1]), bool)
    moved[np.arange(len(rounds))[:, None], rounds, limbs] = True
    states = [_states(one) for one in moved]
    pairs = [
        (stance_of_move(a, b), j)
        for one in states
        for j, (a, b) in enumerate(itertools.pairwise(one))
    ]
    known = dict.fromkeys(pairs)
    if not known:
        return
    use = stance_forces(
        lab,
        np.array([stance for stance, _ in known], np.int64),
        np.array([j for _, j in known], np.int64),
    ).use
    holds = dict(zip(known, np.isfinite(use), strict=True))
    found = 0
    for number, one in enumerate(states):
        if all(holds[pair] for pair in pairs[number * m : (number + 1) * m]):
            yield lab, Sequence(one, tuple(range(m + 1)), 0.0, np.inf), True
            found += 1
            if found == _REPAIRS:
                return


def _laboratory(scene: TransitionScene, toes: Array, poses: Poses, surfaces: Index) -> Laboratory:
    """Footholds start, goal, and one after each round but the last, on their nearest surface."""
    m, n = len(toes) - 1, toes.shape[1]
    toe = np.concatenate([toes[:1], toes[-1:], toes[1:-1]]).swapaxes(0, 1)
    toe[:, GOAL] = scene.goal.toes
    region = np.empty((n, m + 1), np.int64)
    region[:, START], region[:, GOAL] = scene.start.region, scene.goal.region
    for i in range(n):
        for c in range(2, m + 1):
            distance = [scene.terrain.surfaces[s].distance(toe[i, c]) for s in surfaces[i]]
            region[i, c] = surfaces[i][int(np.argmin(distance))]
            toe[i, c] = scene.terrain.surfaces[region[i, c]].project(toe[i, c])
    normal, mu = np.empty_like(toe), np.empty(region.shape)
    for index, surface in enumerate(scene.terrain.surfaces):
        normal[region == index] = surface.normal_at(toe[region == index])
        mu[region == index] = surface.friction
    holds = Footholds(toe, region, normal, mu, np.ones((n, m + 1), bool))
    return Laboratory(scene, holds, poses, reach_of(scene, holds, poses))


def _states(moved: Array) -> tuple[State, ...]:
    """Foothold numbers after each round: a limb's last move takes it to its goal."""
    m, n = moved.shape
    states = np.full((m + 1, n), START)
    for j in range(m):
        for i in range(n):
            last = not moved[j + 1 :, i].any()
            states[j + 1, i] = (GOAL if last else 2 + j) if moved[j, i] else states[j, i]
    return tuple(tuple(int(x) for x in row) for row in states)


def _parts(program: ComplementarityProgram, own: Array) -> dict[str, Array]:
    return {
        name: own[at : at + rows * columns].reshape(columns, rows).T
        for name, at, rows, columns in program.variables.names
    }
