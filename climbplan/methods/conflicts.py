"""Find named blocks of an infeasible program that conflict, by a deletion filter.

Blocks are left out one after the other as long as the rest stays infeasible (Chinneck and Dravnieks
1991). Those that remain conflict, and leaving out any of them (where SCIP decides in time) makes
the rest feasible.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from climbplan.arrays import BoolArray
from climbplan.errors import Conflict
from climbplan.program.instance import Implications, Instance
from climbplan.program.problem import Problem, Theta
from climbplan.solvers.registry import require

_PATIENCE = 2.0  # time limit of one trial [s]
_MAX_BLOCKS = 60  # largest number of blocks, as trials take seconds each


def find_conflicting_blocks(
    problem: Problem, theta: Theta, patience: float = _PATIENCE
) -> list[Conflict]:
    """Return one conflict with the names of its blocks; none if SCIP does not decide.

    Bounds of variables are always kept. `patience` is the time limit [s] of each trial; a trial
    that does not end in time keeps its block.
    """
    instance = replace(problem.instance(theta), constant=0.0)
    instance = replace(instance, P=instance.P * 0, q=instance.q * 0)
    blocks = problem.program.blocks
    names = [b.name for b in blocks.rows] + [b.name for b in blocks.balls]
    names += [b.name for b in blocks.choices] + [b.name for b in blocks.implications]
    if len(names) > _MAX_BLOCKS or not _is_infeasible(instance, patience):
        return []
    remaining = list(names)
    for name in names:
        trial = [candidate for candidate in remaining if candidate != name]
        if _is_infeasible(_select_blocks(problem, instance, set(trial)), patience):
            remaining = trial
    where, what = f"problem {problem.name!r}", tuple(remaining or ["bounds of the variables"])
    return [Conflict(where, what, names=tuple(remaining))]


def _is_infeasible(instance: Instance, patience: float) -> bool:
    """Return whether SCIP proves infeasibility within a time limit [s]."""
    result = require("minlp-scip").load()(instance, gap=1e-2, time_limit=patience)
    return result.status == "infeasible"


def _select_blocks(problem: Problem, instance: Instance, names: set[str]) -> Instance:
    """Return the instance with the rows of the named blocks alone."""
    blocks = problem.program.blocks
    rows = _mask_entries([(b.name, len(b.expression)) for b in blocks.rows], names)
    implication_mask = _mask_entries(
        [(b.name, len(b.expression)) for b in blocks.implications], names
    )
    choices = _mask_entries([(b.name, len(b.alternatives)) for b in blocks.choices], names)
    implications = instance.implications
    return replace(
        instance,
        A=sparse.csr_matrix(instance.A)[rows],
        Q=sparse.csr_matrix(instance.Q)[rows],
        row_lower=instance.row_lower[rows],
        row_upper=instance.row_upper[rows],
        balls=tuple(
            balls
            for balls, block in zip(instance.balls, blocks.balls, strict=True)
            if block.name in names
        ),
        choices=tuple(c for c, keep in zip(instance.choices, choices, strict=True) if keep),
        implications=Implications(
            sparse.csr_matrix(implications.A)[implication_mask],
            sparse.csr_matrix(implications.Q)[implication_mask],
            implications.lower[implication_mask],
            implications.upper[implication_mask],
            implications.binary[implication_mask],
            implications.value[implication_mask],
        ),
    )


def _mask_entries(sizes: list[tuple[str, int]], names: set[str]) -> BoolArray:
    """Return the mask of the entries of named blocks."""
    return np.concatenate([np.zeros(0, bool), *(np.full(n, name in names) for name, n in sizes)])
