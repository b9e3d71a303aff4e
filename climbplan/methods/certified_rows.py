"""Solved rows with the certificates of their bounds, as stored in a file."""

from __future__ import annotations

import math

from climbplan.errors import UsageError
from climbplan.methods.run import SolvedRows, generate_thetas
from climbplan.program.problem import Problem
from climbplan.schema.program.loading import LoadedProgram
from climbplan.solvers.result import relative_gap
from climbplan.store.certified import CertifiedRow, CertifiedRows


def collect_certified_rows(
    problem: Problem, solved_rows: SolvedRows, loaded: LoadedProgram
) -> CertifiedRows:
    """Collect all rows of a run with certificates.

    Raises:
        UsageError: A row has no certificate.
    """
    rows = []
    for theta, row in zip(generate_thetas(problem, loaded), solved_rows.rows, strict=True):
        if row.certificate is None:
            raise UsageError(f"problem {problem.name!r}: method {row.method!r} proves no bound")
        rows.append(
            CertifiedRow(
                parameters=problem.program.theta(theta),
                instance=problem.instance(theta),
                certificate=row.certificate,
                status=row.result.status,
                x=row.result.x,
                assignment=row.result.assignment,
            )
        )
    return CertifiedRows(
        name=loaded.name,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        problem=problem.name,
        gap=loaded.spec.solver.gap,
        tolerance=loaded.spec.solver.tolerance,
        rows=tuple(rows),
    )


def is_weaker_than_search(
    proved: float, searched: float, gap: float, zero_cost: float | None = None
) -> bool:
    """Return whether a proved bound is below a search's by more than rounding and the gap.

    An infinite bound of a search says that nothing is feasible.
    """
    if math.isinf(searched):
        return proved < searched
    return relative_gap(searched, proved, zero_cost) > gap
