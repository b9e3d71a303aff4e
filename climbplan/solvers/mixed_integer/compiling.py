"""Decorate the compiled functions of the mixed-integer search."""

from pathlib import Path
from typing import cast

import numpy as np

from climbplan.compiling import create_compiler

SOURCES = (  # files with compiled functions, and those from which they take constants
    "active_set.py",
    "bounds.py",
    "branching.py",
    "compiling.py",
    "elimination.py",
    "incumbents.py",
    "nodes.py",
    "problem_data.py",
    "propagation.py",
    "search.py",
    "spatial.py",
    "switch_pairs.py",
    "tangent_cuts.py",
    "working_set.py",
)
compiled = create_compiler(
    Path(__file__).parent, SOURCES, borrows_references=True, releases_gil=True
)


def as_runtime_constant(value: int) -> int:
    """Return a number that Numba treats as a run-time value.

    Numba compiles a copy of a large function for each literal that the function is given.
    """
    return cast("int", np.int64(value))
