"""Random mixed-integer convex programs of every block that a program can state."""

from __future__ import annotations

import numpy as np

from climbplan.program import Polytope, Program


def random_program(seed: int, balls: bool = True) -> Program:
    """Small enough for SCIP, some without any feasible point, some with flat or linear costs."""
    rng = np.random.default_rng(seed)
    n, nb = int(rng.integers(2, 7)), int(rng.integers(2, 8))
    p = Program(f"random{seed}")
    x = p.continuous("x", (n,), -5.0, 5.0)
    z = p.binary("z", (nb,))
    for k in range(int(rng.integers(0, 3))):  # equations
        row = rng.normal(size=n)
        p.between(f"equation{k}", np.array([row @ x + 0.5 * rng.normal() * z[0]]), 0.3, 0.3)
    for k in range(int(rng.integers(1, 4))):
        a, b = rng.normal(size=n), rng.normal(size=nb) * (rng.random(nb) < 0.4)
        most = float(rng.uniform(-1, 3))
        if k % 2:
            p.between(f"row{k}", np.array([-(a @ x) - b @ z]), -most, np.inf)
        else:
            p.between(f"row{k}", np.array([a @ x + b @ z]), -np.inf, most)
    if rng.random() < 0.6:
        p.exactly_one("one", z[: int(rng.integers(2, nb + 1))])
    for k in range(int(rng.integers(1, 5))):
        a = rng.normal(size=(2, n))
        low = rng.uniform(-4, 2, 2)
        high = low if rng.random() < 0.2 else low + rng.uniform(0, 3, 2)
        p.when(
            f"when{k}", z[int(rng.integers(nb))], a @ x, low, high, value=bool(rng.random() < 0.6)
        )
    if rng.random() < 0.7:
        points = int(rng.integers(1, 3))
        alternatives = []
        for _ in range(points):
            group = []
            for r in range(int(rng.integers(2, 5))):
                middle, half = rng.uniform(-4, 4, 2), rng.uniform(0.2, 1.5, 2)
                A = np.vstack([np.eye(2), -np.eye(2)])
                b = np.concatenate([middle + half, half - middle])
                group.append(Polytope.halfspaces(f"box{r}", A, b))
            alternatives.append(group)
        p.one_of(
            "regions", np.stack([rng.normal(size=(2, n)) @ x for _ in range(points)]), alternatives
        )
    if balls and rng.random() < 0.5:
        p.ball(
            "ball",
            (rng.normal(size=(1, 2, n)) @ x) + rng.uniform(-1, 1, (1, 2)),
            rng.uniform(0.5, 3),
        )
    kind = rng.integers(3)
    if kind == 0:
        G = rng.normal(size=(n, n))
        p.minimise(
            "cost", float(rng.uniform(0.1, 10)) * np.sum((G @ (x - rng.uniform(-3, 3, n))) ** 2)
        )
    elif kind == 1:  # flat in some directions
        G = rng.normal(size=(max(1, n // 2), n))
        p.minimise(
            "cost", np.sum((G @ x - rng.uniform(-3, 3, len(G))) ** 2) + 0.1 * rng.normal(size=n) @ x
        )
    else:
        p.minimise("cost", rng.normal(size=n) @ x + 0.0 * x[0])
    p.minimise("fixed", rng.uniform(0, 1, nb) @ z)
    return p
