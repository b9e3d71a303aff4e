"""P1 with several envelopes: in each round all (toes, forces, products) lie in one of them.

A mode is a disjunction of polytopes with one binary per envelope and round: the box and the
McCormick planes of its products, eq. (8.26). Branch and bound selects modes and regions together;
the selected envelope states how the robot stands (chapter 5.2.4.3).

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.climb.coupled.envelopes import NamedEnvelope
from climbplan.climb.coupled.preparation import CoupledProblem
from climbplan.climb.coupled.stages import IntegralPoint
from climbplan.climb.coupled.statement import compute_envelope_range
from climbplan.program.instance import Choice, Instance
from climbplan.program.polytope import Polytope
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.local_envelopes import LocalForm
from climbplan.solvers.registry import solve

_GAP = 1e-3  # of P1, whose value is no bound


@dataclass(frozen=True)
class ModePlan:
    """A point of P1 and the mode of each round."""

    candidate: IntegralPoint
    modes: tuple[str, ...]  # (M,) names of envelopes
    nodes: int


def solve_first_stage_with_modes(
    prepared: CoupledProblem, envelopes: tuple[NamedEnvelope, ...], time_limit: float
) -> ModePlan | None:
    """Solve P1 with modes and regions; None without a solution in time."""
    instance, origin = prepared.instance, prepared.origin
    boxes = [compute_envelope_range(prepared.program, instance, e.box, origin) for e in envelopes]
    around = ElementwiseRange(
        np.min([box.lower for box in boxes], axis=0), np.max([box.upper for box in boxes], axis=0)
    )
    form = LocalForm.of(instance)
    local = form.at(around)
    rounds = _list_columns(prepared)
    choices = [
        _build_mode_choice(form, local, envelopes, boxes, r, columns)
        for r, columns in enumerate(rounds)
    ]
    stated = len(local.choices)
    combined = replace(local, choices=(*local.choices, *choices))
    solution = solve(combined, "branch-and-bound", gap=_GAP, time_limit=time_limit)
    if solution.x is None or solution.assignment is None:
        return None
    selected = solution.assignment[stated:]
    return ModePlan(
        IntegralPoint(solution.x[: instance.size], solution.assignment[:stated], "P1 with modes"),
        tuple(envelopes[k].name for k in selected),
        solution.nodes,
    )


def _list_columns(prepared: CoupledProblem) -> IntArray:
    """List the columns (M, 6 N) of toes and forces of each round."""
    toe, force = prepared.program.variables["toe"], prepared.program.variables["force"]
    m = prepared.scene.spec.task.round_count
    return np.concatenate([np.arange(b.start, b.stop).reshape(m, -1) for b in (toe, force)], axis=1)


def _build_mode_choice(
    form: LocalForm,
    local: Instance,
    envelopes: tuple[NamedEnvelope, ...],
    boxes: list[ElementwiseRange],
    number: int,
    columns: IntArray,
) -> Choice:
    """Build the choice of one envelope in a round, for points (toes, forces, products)."""
    products, n = form.source.products, form.source.size
    is_local_product = np.isin(products.first, columns) & np.isin(products.second, columns)
    mode_columns = np.concatenate([columns, n + np.flatnonzero(is_local_product)])
    d = len(mode_columns)
    E = sparse.csr_matrix((np.ones(d), (np.arange(d), mode_columns)), shape=(d, local.size))
    alternatives = []
    for envelope, box in zip(envelopes, boxes, strict=True):
        rows = form.at(box)
        planes = np.flatnonzero(np.repeat(is_local_product, 4)) + form.linear.A.shape[0]
        A = rows.A[planes][:, mode_columns].toarray()
        low, high = box.lower[columns], box.upper[columns]
        eye = np.eye(d)[: len(columns)]
        alternatives.append(
            Polytope.halfspaces(
                envelope.name,
                np.vstack([A, eye, -eye]),
                np.concatenate([rows.row_upper[planes], high, -low]),
            )
        )
    return Choice(f"coupled.mode[{number}]", E, np.zeros(d), tuple(alternatives))
