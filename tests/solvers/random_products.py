"""Random mixed-integer programs with products and squares in plain and in conditional rows."""

from __future__ import annotations

import numpy as np

from climbplan.program import Program


def random_products(seed: int) -> Program:
    """Small enough for SCIP; a few have no feasible point."""
    rng = np.random.default_rng([seed, 7])
    n, nb = int(rng.integers(2, 6)), int(rng.integers(0, 4))
    p = Program(f"products{seed}")
    x = p.continuous("x", (n,), -2.0, 3.0)
    z = p.binary("z", (nb,)) if nb else None

    def bilinear() -> object:
        total = 0.0 * x[0]
        for _ in range(int(rng.integers(1, 4))):
            i, j = rng.integers(n, size=2)
            total = total + rng.normal() * x[i] * x[j]
        return total + rng.normal(size=n) @ x

    for k in range(int(rng.integers(1, 3))):
        low = float(rng.uniform(-2, 1))
        if rng.random() < 0.4:
            p.between(f"equation{k}", np.array([bilinear()]), low, low)
        else:
            p.between(f"row{k}", np.array([bilinear()]), low, low + rng.uniform(0.2, 3.0))
    if z is not None:
        for k in range(int(rng.integers(1, 4))):
            low = float(rng.uniform(-3, 1))
            p.when(
                f"when{k}",
                z[int(rng.integers(nb))],
                bilinear(),
                low,
                low + float(rng.uniform(0, 2)),
                value=bool(rng.random() < 0.5),
            )
        if rng.random() < 0.4:  # a product with an integer factor
            p.between("switched", np.array([x[0] * z[0] + x[1]]), -0.5, 0.5)
        if nb > 1:
            p.between("some", np.array([z[0] + z[1]]), 1.0, 2.0)
        p.minimise("fixed", rng.uniform(0, 1, nb) @ z)
    if rng.random() < 0.3:
        p.ball("ball", (x[None, :2] - rng.uniform(-1, 1, (1, 2))), float(rng.uniform(0.8, 3)))
    if rng.random() < 0.7:
        p.minimise("cost", np.sum((x - rng.uniform(-3, 3, n)) ** 2))
    else:
        p.minimise("cost", rng.normal(size=n) @ x)
    return p
