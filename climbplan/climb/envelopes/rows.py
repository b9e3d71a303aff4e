"""Labelled terrains: Algorithm 1 of chapter 5.2.2, with infeasibility proved.

A feasible row holds a point of problem P; an infeasible one a solution of P without its bilinear
rows. Terrains on which even that has none say nothing about envelopes and are counted only.

Chapter and algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.envelopes.relaxation import solve_relaxed
from climbplan.climb.envelopes.search import drop_products, find_posture, minimise_product_error
from climbplan.climb.envelopes.statement import PostureStatement
from climbplan.climb.envelopes.terrains import LimbPatches, TerrainDistribution
from climbplan.program.instance import Instance

NODES = 300  # of the search, before a terrain is left undecided


@dataclass(frozen=True)
class TerrainDataset:
    """n labelled terrains of one distribution."""

    terrain: Array  # (n, p) vectors of patches
    feasible: BoolArray  # (n,)
    point: Array  # (n, N, 6) toe [P] and force [weights] of each limb
    drawn: int  # terrains sampled
    trivial: int  # without a solution even of the linear part
    undecided: int  # neither a point nor a proof within the nodes

    def patches(self, k: int) -> LimbPatches:
        """Return the terrain of a row."""
        return LimbPatches.from_vector(self.terrain[k])


def extract_factors(statement: PostureStatement, x: Array) -> Array:
    """Return toes and forces (N, 6) of a point."""
    return np.concatenate(
        [statement.program.value("toe", x), statement.program.value("force", x)], axis=1
    )


def find_linear_point(instance: Instance) -> Array | None:
    """Return a solution of P without its bilinear rows, None if there is none."""
    point_and_error = minimise_product_error(
        drop_products(instance), np.zeros(0), np.zeros(0, np.int64)
    )
    return None if point_and_error is None else point_and_error[0]


def collect_rows(
    terrains: TerrainDistribution,
    statement: PostureStatement,
    feasible: int,
    infeasible: int,
    seed: int,
    report: Callable[[float], None] | None = None,
) -> TerrainDataset:
    """Draw terrains until there are enough feasible and enough infeasible ones.

    Row k of the draw depends on (seed, k) alone. Terrains of a kind that is complete are skipped.
    """
    rows: list[tuple[Array, bool, Array]] = []
    remaining = {True: feasible, False: infeasible}
    num_drawn = trivial = undecided = 0
    while any(remaining.values()):
        patches = terrains.sample(np.random.default_rng([seed, num_drawn]))
        num_drawn += 1
        theta = statement.theta(patches)
        # A root without a solution is a proof; one with a solution nearly always has a point, and
        # is one of the linear part
        root = solve_relaxed(statement.legs, patches, theta["force"], theta["moment"])
        if root is not None and not remaining[True]:
            continue
        linear = find_linear_point(statement.program.instantiate(theta))
        if linear is None:
            trivial += 1
            continue
        if root is None and not remaining[False]:
            continue
        label, x = False, linear
        if root is not None:
            answer = find_posture(statement, patches, nodes=NODES)
            if answer.status == "limit":
                undecided += 1
                continue
            if answer.x is not None:
                label, x = True, answer.x
        if not remaining[label]:
            continue
        remaining[label] -= 1
        rows.append((patches.vector(), label, extract_factors(statement, x)))
        if report is not None:
            report(len(rows) / (feasible + infeasible))
    return TerrainDataset(
        np.array([r[0] for r in rows]),
        np.array([r[1] for r in rows], bool),
        np.array([r[2] for r in rows]),
        num_drawn,
        trivial,
        undecided,
    )
