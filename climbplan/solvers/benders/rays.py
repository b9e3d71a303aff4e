"""A ray of an infeasible linear program from HiGHS, for programs that the tree's solver gives up.

What it proves is computed from the ray like that of any other cut, so that HiGHS is not believed.
"""

from __future__ import annotations

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array, IntArray
from climbplan.solvers.benders.cuts import Cut, CutForm
from climbplan.solvers.highs.model import highs, linear_model, run_highs
from climbplan.solvers.mixed_integer.conditional import Conditional

_LEAST = 1e-12  # entries of a ray below this share of the largest are rounding


def farkas_ray(form: Conditional, read: CutForm, integers: IntArray, x: Array) -> Cut | None:
    """A cut that excludes integers (E,), None where none is found. x: (size,) a point near them."""
    program = read.program
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[program.entities] = upper[program.entities] = integers
    on = np.flatnonzero(form.value == lower[form.when])
    A = sparse.vstack([form.A, form.C[on]]).tocsr()
    solver = highs()
    solver.setOptionValue("presolve", "off")  # which keeps no rays
    solver.passModel(
        linear_model(
            np.zeros(form.size),
            0.0,
            lower,
            upper,
            np.zeros(form.size, bool),
            A,
            np.concatenate([form.row_lower, form.when_lower[on]]),
            np.concatenate([form.row_upper, form.when_upper[on]]),
        )
    )
    run_highs(solver)
    if solver.getModelStatus() != highspy.HighsModelStatus.kInfeasible:
        return None
    _, there, ray = solver.getDualRay()
    if not there:
        return None
    rows = np.concatenate([np.arange(A.shape[0] - len(on)), A.shape[0] - len(on) + on])
    for y in (np.asarray(ray), -np.asarray(ray)):
        both = np.concatenate([-(A.T @ y), y])  # bounds take what rows pull at each variable
        key = np.concatenate([np.arange(form.size), form.size + rows])
        keep = np.abs(both) > _LEAST * np.abs(both).max(initial=0.0)
        cut = Cut(key[keep], both[keep] / np.abs(both).max(initial=1e-300), x, False)
        plane = read.planes([cut])
        off = np.where((integers > 0) == plane.star[0], 0.0, plane.slope[0]).sum()
        if plane.bound[0] - off > 0.0:
            return cut
    return None
