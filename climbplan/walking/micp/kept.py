"""A relaxed program that stays in the solver while its integers are decided one after the other.

Each linear program starts where the one before ended, by the dual simplex method: deciding changes
bounds alone. Tangents come where a point wants them, and go when the next part of a search begins,
so that what a part finds does not depend on what was asked before.
"""

from __future__ import annotations

from typing import NamedTuple

import highspy
import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.solvers.highs.model import rows_model, run_highs
from climbplan.walking.micp.mirror import left_first
from climbplan.walking.micp.relaxed import add_rows, infeasible, linear, solve_linear
from climbplan.walking.micp.statement import Relaxation

_ROUNDS = 4  # of tangents
_UNSURE = 0.03  # of a contact, that it is worth to decide early
_WHOLE = 1e-5  # off an integer, that counts as one


class Decision(NamedTuple):
    """Whether a leg stands at a knot, or whether a part is chosen."""

    contact: bool  # place is a row of `Relaxation.rows`, else of a binary's column
    place: int
    value: float


class Point(NamedTuple):
    """A bound, and where the relaxed program has it; no point where the solver has none."""

    bound: float
    x: Array | None


class Kept:
    """Linear programs of a relaxation, with ever other integers decided."""

    def __init__(self, program: Relaxation, sag: float, images: bool = False) -> None:
        """sag: of the cost, that squares may be too small; images: one of two that mirror."""
        self.program, self.sag, self.most = program, sag, program.most
        model = program.model
        if images:
            model.least("gait.images", left_first(program))
        self.count = len(model)
        self.decided: tuple[Decision, ...] = ()
        self.row_low, self.row_high = model.row_lower, model.row_upper
        self.binaries = np.flatnonzero(model.integer)
        known = program.box
        self.open: BoolArray = known.stands_low < known.stands_high
        self.solver = linear()
        self.solver.passModel(rows_model(model, relaxed=True))
        # What costs more ends a program by its bound, which takes no row.
        self.solver.changeRowBounds(program.known, -np.inf, np.inf)
        self.solver.setOptionValue("objective_bound", self.most)
        run_highs(self.solver)
        # Costs as they are: what is perturbed has to be undone in each of them.
        self.solver.setOptionValue("dual_simplex_cost_perturbation_multiplier", 0.0)
        self.solver.setOptionValue("presolve", "off")  # from here on each starts where one ended
        self.basis = self.solver.getBasis()

    def begin(self) -> None:
        """As it was at first: nothing is decided, and there are no further tangents."""
        self.decide(())
        now = self.solver.getNumRow()
        if now > self.count:
            further = np.arange(self.count, now, dtype=np.int32)
            self.solver.deleteRows(len(further), further)
            self.program.model.forget(self.count)
        self.solver.setBasis(self.basis)

    def decide(self, decided: tuple[Decision, ...]) -> None:
        """Have these decided, and no others."""
        model, solver = self.program.model, self.solver
        for one in self.decided:
            k = one.place
            if one.contact:
                solver.changeRowBounds(k, self.row_low[k], self.row_high[k])
            else:
                solver.changeColBounds(k, model.lower[k], model.upper[k])
        for one in decided:
            change = solver.changeRowBounds if one.contact else solver.changeColBounds
            change(one.place, one.value, one.value)
        self.decided = decided

    def solve(self, left: float) -> Point | None:
        """What costs least of what is decided; None if nothing costs less than `most`.

        left: [s] by the wall's clock, infinite where that does not count.
        """
        found = Point(0.0, None)
        for _ in range(_ROUNDS):
            if np.isfinite(left):
                self.solver.setOptionValue("time_limit", self.solver.getRunTime() + left)
            status = solve_linear(self.solver)
            if status == highspy.HighsModelStatus.kObjectiveBound:
                return None
            if status == highspy.HighsModelStatus.kInfeasible:
                if infeasible(self.solver):
                    return None
                status = self.solver.getModelStatus()
            if status != highspy.HighsModelStatus.kOptimal:
                break
            value = float(self.solver.getInfo().objective_function_value)
            if value >= self.most:
                return None
            found = Point(max(value, found.bound), np.array(self.solver.getSolution().col_value))
            before = len(self.program.model)
            if found.x is None or not self.program.model.refine(found.x, self.sag):
                break
            add_rows(self.solver, self.program.model, before)
        return found

    @property
    def contacts(self) -> BoolArray | None:
        """Contacts (N, L), if all are decided."""
        stands, open_ = self.program.box.stands_low > 0, self.open.copy()
        at = {int(row): at for at, row in np.ndenumerate(self.program.rows)}
        for one in self.decided:
            if one.contact:
                stands[at[one.place]], open_[at[one.place]] = one.value > 0, False
        return None if open_.any() else stands

    def next(self, x: Array | None) -> tuple[Decision, Decision] | None:
        """What is decided next at a point, likely first; None if its integers are whole.

        Legs by half at the first knot that has any, then what else is open, then parts.
        """
        open_, rows = self.open.copy(), self.program.rows
        open_ &= ~np.isin(rows, [one.place for one in self.decided if one.contact])
        stands = self.program.standing(x) if x is not None else np.full(rows.shape, 0.5)
        half = np.where(open_, np.minimum(stands, 1.0 - stands), -1.0)
        if open_.any():
            early = np.flatnonzero((half > _UNSURE).any(axis=1))
            n = int(early[0]) if len(early) else int(np.flatnonzero(open_.any(axis=1))[0])
            leg = int(half[n].argmax())
            index, likely = int(rows[n, leg]), float(stands[n, leg] >= 0.5)
            return Decision(True, index, likely), Decision(True, index, 1.0 - likely)
        parts = x[self.binaries] if x is not None else np.zeros(0)
        off = np.minimum(parts, 1.0 - parts)
        if not len(off) or off.max() <= _WHOLE:
            return None
        column = int(self.binaries[off.argmax()])
        likely = float(parts[off.argmax()] >= 0.5)
        return Decision(False, column, likely), Decision(False, column, 1.0 - likely)
