"""Random instances for solver tests: limbs that step over polygons, and tiny ones of all kinds."""

from __future__ import annotations

import itertools

import numpy as np

from climbplan.arrays import Array
from climbplan.program import Instance, Polytope, Program


def polygon(name: str, corners: Array, frame: Array, origin: Array) -> Polytope:
    """A convex polygon in space from its corners (K, 2), anticlockwise, in a plane.

    frame: (3, 3) with columns along, up, normal.
    """
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    in_plane = frame[:, :2]
    vertices = origin + corners @ in_plane.T
    A = normals @ in_plane.T
    return Polytope(
        name,
        A,
        np.einsum("ij,ij->i", A, vertices),
        frame[:, 2][None],
        np.array([frame[:, 2] @ origin]),
        vertices,
    )


def random_polygon(rng: np.random.Generator, center: Array, size: float) -> Array:
    """Corners of a random convex polygon with three to six corners."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
    while np.diff([*angles, angles[0] + 2 * np.pi]).max() > 0.9 * np.pi:
        angles = np.sort(rng.uniform(0, 2 * np.pi, len(angles)))
    return center + size * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def frame_of(tilt: float, turn: float) -> Array:
    """Columns along, up, normal of a wall turned about z and tilted back."""
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    up = np.array([-np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)])
    return np.stack([across, up, np.cross(across, up)], axis=1)


def stepping_scene(
    seed: int,
    rounds: int = 3,
    limbs: int = 2,
    patches: int = 3,
    tilted: bool = True,
    step: float = 0.55,
    reach: float = 1.0,
    blocked: bool = False,
    goal_tolerance: float | None = None,
) -> Program:
    """Limbs step over polygons on two walls, a body between them stays within reach of all.

    blocked: a box in the middle that the body has to pass on one side (unbounded alternatives).
    """
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(-0.4, 0.4, 2) if tilted else np.zeros(2)
    walls = []
    for side, angle in zip((-1.0, 1.0), tilt, strict=True):
        frame, origin = frame_of(angle, np.pi / 2), np.array([side * 0.6, 0.0, 0.0])
        walls.append(
            [
                polygon(
                    f"patch {k}",
                    random_polygon(
                        rng, np.array([rng.uniform(-0.2, 0.2), 0.45 * k]), rng.uniform(0.12, 0.25)
                    ),
                    frame,
                    origin,
                )
                for k in range(patches)
            ]
        )
    start = np.array([walls[i % 2][0].vertices.mean(axis=0) for i in range(limbs)])
    goal = np.array([walls[i % 2][-1].vertices.mean(axis=0) for i in range(limbs)])
    body0, body1 = start.mean(axis=0), goal.mean(axis=0)

    p = Program("stepping")
    toe = p.continuous("toe", (rounds, limbs, 3), -3.0, 3.0)
    body = p.continuous("body", (rounds, 3), -3.0, 3.0)
    toes = np.concatenate([start[None].astype(object), toe])
    bodies = np.concatenate([body0[None].astype(object), body])
    p.ball("toe_step", np.diff(toes, axis=0), step)
    p.ball("body_step", np.diff(bodies, axis=0), step)
    p.ball("reach", toe - body[:, None], reach)
    p.between("level", np.diff(bodies[:, 2]), -0.4, 0.5)
    p.one_of("patch", toe, [walls[i % 2] for i in range(limbs)] * rounds)
    if blocked:
        middle = 0.5 * (body0 + body1) + rng.uniform(-0.05, 0.05, 3)
        half = np.array([0.4, 0.15, 0.12])
        sides = [
            Polytope.halfspaces(
                f"side {axis} {sign}", A := -sign * np.eye(3)[[axis]], A @ middle - half[axis]
            )
            for axis, sign in itertools.product(range(3), (-1.0, 1.0))
        ]
        p.one_of("body_free", body, [sides] * rounds)
    if goal_tolerance is not None:
        p.ball("at_goal", toe[-1] - goal, goal_tolerance)
    p.minimise("goal", np.sum((toe[-1] - goal) ** 2) + np.sum((body[-1] - body1) ** 2))
    p.minimise("toe_step", 0.05 * np.sum(np.diff(toes, axis=0) ** 2))
    p.minimise("body_step", 0.02 * np.sum(np.diff(bodies, axis=0) ** 2))
    return p


def tiny_instance(seed: int) -> Instance:
    """A few variables with everything at once.

    Balls of radius zero among them, equations, fixed variables, flat and linear costs, choices of
    boxes, half-spaces, planes and empty alternatives, with and without vertices, on points that
    may be constant.
    """
    rng = np.random.default_rng(seed)
    p = Program("tiny")
    x = p.continuous("x", (int(rng.integers(2, 6)),), -2.0, 2.0)
    if rng.random() < 0.3:
        x = np.concatenate([x, p.continuous("fixed", (1,), 0.3, 0.3)])
    n = len(x)

    def sparse_rows(count: int, density: float) -> Array:
        return rng.normal(size=(count, n)) * (rng.random((count, n)) < density)

    for k in range(rng.integers(0, 3)):
        d = int(rng.integers(1, 4))
        radius = 0.0 if rng.random() < 0.05 else 0.2 + abs(rng.normal())
        vector = sparse_rows(d, 0.6) @ x + 0.5 * rng.normal(size=d)
        p.ball(f"ball {k}", vector[None], radius)
    for k in range(rng.integers(0, 3)):
        row, level = sparse_rows(1, 0.7) @ x, 0.5 * rng.normal()
        if rng.random() < 0.25:
            p.equal(f"row {k}", row - level)
        else:
            p.between(f"row {k}", row, -np.inf if rng.random() < 0.5 else level - 1.0, level)
    for k in range(rng.integers(1, 4)):
        d = int(rng.integers(1, 4))
        if rng.random() < 0.5 and d <= n:
            E = np.eye(n)[rng.permutation(n)[:d]]
        else:
            E = sparse_rows(d, 0.6) * (rng.random() > 0.08)
        plane = rng.normal(size=d)
        alternatives = [_alternative(rng, d, plane) for _ in range(rng.integers(1, 4))]
        p.one_of(f"choice {k}", (E @ x + 0.3 * rng.normal(size=d))[None], [alternatives])
    G = sparse_rows(int(rng.integers(1, n + 1)), 0.8)
    p.minimise("squares", np.sum((G @ x - rng.normal(size=len(G))) ** 2))
    if rng.random() < 0.3:
        p.minimise("slope", np.sum(rng.normal(size=n) * x))
    return p.instantiate()


def _alternative(rng: np.random.Generator, d: int, plane: Array) -> Polytope:
    kind = rng.random()
    none = np.zeros((0, d)), np.zeros(0)
    box = np.vstack([np.eye(d), -np.eye(d)])
    if kind < 0.55:
        center, half = 0.8 * rng.normal(size=d), rng.uniform(0.05, 0.5, d)
        bound = np.concatenate([center + half, half - center])
        vertices = np.array(
            list(itertools.product(*zip(center - half, center + half, strict=True)))
        )
        if kind < 0.05:  # empty
            return Polytope("empty", box, bound - 3.0 * np.tile(half, 2), *none)
        return Polytope("box", box, bound, *none, vertices if kind < 0.45 else None)
    if kind < 0.8:
        A = rng.normal(size=(rng.integers(1, 3), d))
        return Polytope.halfspaces("half-space", A, 0.5 * rng.normal(size=len(A)) - 0.3)
    normal = plane if kind < 0.9 else rng.normal(size=d)
    return Polytope("plane", box, np.ones(2 * d), normal[None], np.array([0.1]))
