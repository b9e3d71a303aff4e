"""Compiled code made or loaded before any clock runs: on a fresh machine that takes a minute.

Limits in seconds are on searching. Left to the first search, compiling would use them up, and a
short limit would end with nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from climbplan.program import Program
from climbplan.program.instance import Instance

_done: set[tuple[str, bool]] = set()


def warm_up(search: str, solve: Callable[[Instance], object], products: bool = False) -> None:
    """Take a program of a few rows through a search, once in a process.

    search: its name; solve: as it is without a limit. What is compiled does not depend on numbers,
    only on what is called.
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
    solve(p.at())
