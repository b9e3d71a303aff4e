"""Compile or load the search kernels before a time limit starts to run.

On a fresh machine compilation takes up to a minute. A time limit covers the search only; otherwise
compilation would use it up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.program import Program
from climbplan.program.instance import Instance

_done: set[tuple[str, bool]] = set()


def warm_up_kernels(
    search: str, solve: Callable[[Instance], object], products: bool = False
) -> None:
    """Solve a program of a few rows with a search, once per process.

    Args:
        search: Name of the search, by which it is warmed up once only.
        solve: Function that solves an instance without limits.
        products: Whether the program has a product of two variables.
    """
    key = search, products
    if key in _done:
        return
    _done.add(key)
    p = Program("warm-up")
    x, z = p.continuous("x", (2,), -1.0, 1.0), p.binary("z", (2,))
    p.when("right", z[0], x[:1], lower=0.2)
    p.when("left", z[0], x[:1], upper=0.1, value=False)
    p.between("one", np.array([z[0] + z[1]]), 1.0, 1.0)
    if products:
        p.between("product", np.array([x[0] * x[1]]), -0.2, 0.2)
    p.minimise("cost", np.sum((x - np.array([0.15, 0.7])) ** 2))
    solve(p.instantiate())
