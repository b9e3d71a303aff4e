"""The decorator of compiled functions of the mixed-integer search."""

from pathlib import Path
from typing import cast

import numpy as np

from climbplan.solvers.compiling import compiler

compiled = compiler(Path(__file__).parent, "*.py", borrows=True, lets_go=True)


def constant(value: int) -> int:
    """A number to be given to large functions: Numba compiles these anew for each literal."""
    return cast("int", np.int64(value))
