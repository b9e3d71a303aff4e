"""The linear program of a node, kept in the solver while branching decisions change.

Decisions change bounds of rows and columns alone, so that the dual simplex method starts each
program from the basis of the one before. Tangents that cut off a solution are added to the program,
and removed when the next dive begins: the outcome of a dive does not depend on earlier ones.
"""

from __future__ import annotations

from typing import NamedTuple

import highspy
import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.solvers.highs.model import build_rows_model, run_highs
from climbplan.walking.micp.outer_approximation import (
    add_rows,
    confirm_infeasible,
    create_lp_solver,
    solve_lp,
)
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.micp.symmetry import build_symmetry_breaker

_MAX_CUT_ROUNDS = 4  # of tangents in a node
_MIN_FRACTIONALITY = 0.03  # of a contact that is branched on before those of later knots
_INTEGRALITY_TOLERANCE = 1e-5


class BranchingDecision(NamedTuple):
    """A contact or a binary that is fixed."""

    is_contact: bool  # whether `place` is a row of `contact_rows`; else it is a binary's column
    place: int
    value: float  # 0 or 1


class LpSolution(NamedTuple):
    """The bound of a node, and where the linear program attains it."""

    bound: float
    x: Array | None  # (n,); None if the solver has no solution


class NodeLp:
    """The linear relaxation of a program under branching decisions."""

    def __init__(
        self,
        program: MixedIntegerRelaxation,
        tangent_tolerance: float,
        breaks_symmetry: bool = False,
    ) -> None:
        """Load the relaxation into the solver.

        Args:
            program: The relaxation; a row that breaks its symmetry may be added to it.
            tangent_tolerance: Largest violation of a square's tangents that is accepted (a cost).
            breaks_symmetry: Whether to keep only one motion of each mirrored pair.
        """
        self.program, self.tangent_tolerance = program, tangent_tolerance
        self.cutoff = program.cutoff
        model = program.model
        if breaks_symmetry:
            model.add_nonnegative("gait.images", build_symmetry_breaker(program))
        self.num_rows = len(model)
        self.decisions: tuple[BranchingDecision, ...] = ()
        self.row_low, self.row_high = model.row_lower, model.row_upper
        self.binaries = np.flatnonzero(model.integer)
        bounds = program.bounds
        self.undecided: BoolArray = bounds.contact_low < bounds.contact_high
        self.solver = create_lp_solver()
        self.solver.passModel(build_rows_model(model, relaxed=True))
        # The objective bound of the solver replaces the row of the cutoff.
        self.solver.changeRowBounds(program.cutoff_row, -np.inf, np.inf)
        self.solver.setOptionValue("objective_bound", self.cutoff)
        run_highs(self.solver)
        # Perturbed costs would have to be undone in every program.
        self.solver.setOptionValue("dual_simplex_cost_perturbation_multiplier", 0.0)
        self.solver.setOptionValue("presolve", "off")  # presolve would discard the basis
        self.basis = self.solver.getBasis()

    def reset(self) -> None:
        """Return to the root: undo all decisions and added tangents, and restore its basis."""
        self.apply_decisions(())
        num_rows = self.solver.getNumRow()
        if num_rows > self.num_rows:
            added = np.arange(self.num_rows, num_rows, dtype=np.int32)
            self.solver.deleteRows(len(added), added)
            self.program.model.forget(self.num_rows)
        self.solver.setBasis(self.basis)

    def apply_decisions(self, decisions: tuple[BranchingDecision, ...]) -> None:
        """Replace the current decisions by others."""
        model, solver = self.program.model, self.solver
        for decision in self.decisions:
            k = decision.place
            if decision.is_contact:
                solver.changeRowBounds(k, self.row_low[k], self.row_high[k])
            else:
                solver.changeColBounds(k, model.lower[k], model.upper[k])
        for decision in decisions:
            change = solver.changeRowBounds if decision.is_contact else solver.changeColBounds
            change(decision.place, decision.value, decision.value)
        self.decisions = decisions

    def solve(self, seconds_left: float) -> LpSolution | None:
        """Solve the linear program, with rounds of tangents that cut off its solutions.

        Args:
            seconds_left: Limit on wall-clock time [s]; infinite if there is none.

        Returns:
            The bound and its solution; None if the node is pruned.
        """
        solution = LpSolution(0.0, None)
        for _ in range(_MAX_CUT_ROUNDS):
            if np.isfinite(seconds_left):
                self.solver.setOptionValue("time_limit", self.solver.getRunTime() + seconds_left)
            status = solve_lp(self.solver)
            if status == highspy.HighsModelStatus.kObjectiveBound:
                return None
            if status == highspy.HighsModelStatus.kInfeasible:
                if confirm_infeasible(self.solver):
                    return None
                status = self.solver.getModelStatus()
            if status != highspy.HighsModelStatus.kOptimal:
                break
            value = float(self.solver.getInfo().objective_function_value)
            if value >= self.cutoff:
                return None
            x = np.array(self.solver.getSolution().col_value)
            solution = LpSolution(max(value, solution.bound), x)
            first_new_row = len(self.program.model)
            if not self.program.model.add_violated_tangents(x, self.tangent_tolerance):
                break
            add_rows(self.solver, self.program.model, first_new_row)
        return solution

    @property
    def decided_contacts(self) -> BoolArray | None:
        """Contacts (N, L) if all are decided, else None."""
        contacts, undecided = self.program.bounds.contact_low > 0, self.undecided.copy()
        index_of_row = {int(row): index for index, row in np.ndenumerate(self.program.contact_rows)}
        for decision in self.decisions:
            if decision.is_contact:
                index = index_of_row[decision.place]
                contacts[index], undecided[index] = decision.value > 0, False
        return None if undecided.any() else contacts

    def select_branching(
        self, x: Array | None
    ) -> tuple[BranchingDecision, BranchingDecision] | None:
        """Select the contact or binary to branch on.

        Contacts come before binaries: the most fractional one of the first knot that has any.

        Args:
            x: Solution of the linear program (n,); None if there is none.

        Returns:
            Both decisions, the one that rounds the solution first; None if it is integral.
        """
        undecided, rows = self.undecided.copy(), self.program.contact_rows
        undecided &= ~np.isin(rows, [d.place for d in self.decisions if d.is_contact])
        contacts = self.program.evaluate_contacts(x) if x is not None else np.full(rows.shape, 0.5)
        fractionality = np.where(undecided, np.minimum(contacts, 1.0 - contacts), -1.0)
        if undecided.any():
            fractional = np.flatnonzero((fractionality > _MIN_FRACTIONALITY).any(axis=1))
            n = int(fractional[0] if len(fractional) else np.flatnonzero(undecided.any(axis=1))[0])
            leg = int(fractionality[n].argmax())
            row, rounded = int(rows[n, leg]), float(contacts[n, leg] >= 0.5)
            return BranchingDecision(True, row, rounded), BranchingDecision(
                True, row, 1.0 - rounded
            )
        values = x[self.binaries] if x is not None else np.zeros(0)
        fractionality = np.minimum(values, 1.0 - values)
        if not len(fractionality) or fractionality.max() <= _INTEGRALITY_TOLERANCE:
            return None
        column = int(self.binaries[fractionality.argmax()])
        rounded = float(values[fractionality.argmax()] >= 0.5)
        return (
            BranchingDecision(False, column, rounded),
            BranchingDecision(False, column, 1.0 - rounded),
        )
