"""Which named blocks of an infeasible program cannot hold together.

Blocks are left out one after the other for as long as the rest stays infeasible: those that remain
conflict, and leaving out any of them (where SCIP could tell in time) makes the rest feasible.
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

_PATIENCE = 2.0  # [s] of one trial
_MOST_BLOCKS = 60  # beyond, the trials would take minutes


def conflicting_blocks(
    problem: Problem, theta: Theta, patience: float = _PATIENCE
) -> list[Conflict]:
    """One conflict that names blocks, bounds of variables always kept; none if SCIP cannot tell.

    patience: [s] of each trial; a trial that does not end in time keeps its block.
    """
    instance = replace(problem.instance(theta), constant=0.0)
    instance = replace(instance, P=instance.P * 0, q=instance.q * 0)
    blocks = problem.program.blocks
    names = [b.name for b in blocks.rows] + [b.name for b in blocks.balls]
    names += [b.name for b in blocks.choices] + [b.name for b in blocks.implications]
    if len(names) > _MOST_BLOCKS or not _infeasible(instance, patience):
        return []
    kept = list(names)
    for name in names:
        rest = [other for other in kept if other != name]
        if _infeasible(_only(problem, instance, set(rest)), patience):
            kept = rest
    where, what = f"problem {problem.name!r}", tuple(kept or ["bounds of the variables"])
    return [Conflict(where, what, names=tuple(kept))]


def _infeasible(instance: Instance, patience: float) -> bool:
    found = require("minlp-scip").load()(instance, gap=1e-2, time_limit=patience)
    return found.status == "infeasible"


def _only(problem: Problem, instance: Instance, kept: set[str]) -> Instance:
    """The instance with the rows of the named blocks alone."""
    blocks = problem.program.blocks
    rows = _held([(b.name, len(b.expression)) for b in blocks.rows], kept)
    held = _held([(b.name, len(b.expression)) for b in blocks.implications], kept)
    choices = _held([(b.name, len(b.alternatives)) for b in blocks.choices], kept)
    implied = instance.implications
    return replace(
        instance,
        A=sparse.csr_matrix(instance.A)[rows],
        Q=sparse.csr_matrix(instance.Q)[rows],
        row_lower=instance.row_lower[rows],
        row_upper=instance.row_upper[rows],
        balls=tuple(
            balls
            for balls, block in zip(instance.balls, blocks.balls, strict=True)
            if block.name in kept
        ),
        choices=tuple(c for c, keep in zip(instance.choices, choices, strict=True) if keep),
        implications=Implications(
            sparse.csr_matrix(implied.A)[held],
            sparse.csr_matrix(implied.Q)[held],
            implied.lower[held],
            implied.upper[held],
            implied.binary[held],
            implied.value[held],
        ),
    )


def _held(sizes: list[tuple[str, int]], kept: set[str]) -> BoolArray:
    return np.concatenate([np.zeros(0, bool), *(np.full(n, name in kept) for name, n in sizes)])
