"""The decorator of compiled functions of the mixed-integer search."""

from pathlib import Path
from typing import cast

import numpy as np

from climbplan.solvers.compiling import compiler

SOURCES = (  # files with compiled functions, and those that they take numbers from
    "active_set.py",
    "bounds.py",
    "branching.py",
    "compiling.py",
    "elimination.py",
    "incumbents.py",
    "nodes.py",
    "numbers.py",
    "pairs.py",
    "propagation.py",
    "search.py",
    "spatial.py",
    "tangents.py",
    "working_set.py",
)
compiled = compiler(Path(__file__).parent, SOURCES, borrows=True, lets_go=True)


def constant(value: int) -> int:
    """A number to be given to large functions: Numba compiles these anew for each literal."""
    return cast("int", np.int64(value))
