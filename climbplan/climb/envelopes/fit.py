"""Fitting envelopes to labelled terrains, and the validation table of chapter 5.2.3.

Published methods, and chapter and table numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.climb.envelopes.first_stage import FirstStage, Manner
from climbplan.climb.envelopes.rows import TerrainDataset
from climbplan.climb.envelopes.search import drop_products, minimise_product_error
from climbplan.climb.envelopes.statement import PostureStatement
from climbplan.climb.envelopes.terrains import TerrainDistribution
from climbplan.learning.envelope_box import Envelope, EnvelopeSet
from climbplan.program.instance import Instance
from climbplan.solvers.ipopt.instances import solve_ipopt

_SEARCH_TIME = 2.0  # [s] of a local search for one point


def build_projection(stage: FirstStage, centre: Array, weight: Array) -> Instance:
    """Return P with the cost sum of weight (factor - centre)^2; centre, weight: (N, 6)."""
    instance, factor_columns = stage.instance, stage.factors.ravel()
    w, c = weight.ravel(), centre.ravel()
    n = instance.size
    P = sparse.csc_matrix((2.0 * w, (factor_columns, factor_columns)), shape=(n, n))
    q = np.zeros(n)
    q[factor_columns] = -2.0 * w * c
    return replace(instance, P=P, q=q, constant=float(w @ c**2))


def find_nearest_point(
    stage: FirstStage, start: Array, centre: Array, weight: Array
) -> Array | None:
    """Return a local optimum (N, 6) by IPOPT from the factors of a feasible point, or None."""
    x = np.zeros(stage.instance.size)
    x[stage.factors.ravel()] = start.ravel()
    solution = solve_ipopt(
        build_projection(stage, centre, weight), start=x, time_limit=_SEARCH_TIME
    ).x
    return None if solution is None else solution[stage.factors]


def _restrict_to_box(stage: FirstStage, envelope: Envelope) -> Instance | None:
    box = stage.box(envelope.lower, envelope.upper)
    if box is None:
        return None
    return replace(stage.instance, lower=box.lower, upper=box.upper)


def contains_point(stage: FirstStage, envelope: Envelope, x: Array | None = None) -> bool:
    """Return whether a point of P was found in the box; False proves nothing.

    x: a point of P1 to start from, found if left out.
    """
    if x is None:
        x = stage.solve(envelope.lower, envelope.upper, (envelope.lower + envelope.upper) / 2)
    boxed = _restrict_to_box(stage, envelope)
    if x is None or boxed is None:
        return False
    return solve_ipopt(boxed, start=x, time_limit=_SEARCH_TIME).x is not None


def contains_linear_point(stage: FirstStage, envelope: Envelope) -> bool:
    """Return whether P without its bilinear rows has a point in the box: a linear program, so
    exact.
    """
    boxed = _restrict_to_box(stage, envelope)
    if boxed is None:
        return False
    no_factors = np.zeros(0)
    return (
        minimise_product_error(drop_products(boxed), no_factors, np.zeros(0, np.int64)) is not None
    )


Method = Literal["clustering", "genetic", "heuristic"]
_RECENTRINGS = 2
_LEAST_SPREAD = 0.02  # of a factor, below which it counts as this


def prepare_stages(
    statement: PostureStatement, rows: TerrainDataset, manner: Manner
) -> list[FirstStage]:
    """Return P1 on every terrain, ready for any envelope."""
    return [FirstStage.of(statement, rows.patches(k), manner) for k in range(len(rows.terrain))]


def recentre_points(
    rows: TerrainDataset,
    prepared: list[FirstStage],
    report: Callable[[float], None] | None = None,
    times: int = _RECENTRINGS,
) -> TerrainDataset:
    """Return the rows with each feasible point moved towards the median within its feasible set."""
    point = rows.point.copy()
    feasible_rows = np.flatnonzero(rows.feasible)
    for iteration in range(times):
        centre = np.median(point[feasible_rows], axis=0)
        weight = 1.0 / np.maximum(point[feasible_rows].std(axis=0), _LEAST_SPREAD) ** 2
        for done, k in enumerate(feasible_rows):
            recentred_point = find_nearest_point(prepared[k], point[k], centre, weight)
            point[k] = point[k] if recentred_point is None else recentred_point
            if report is not None:
                report((iteration + (done + 1) / len(feasible_rows)) / times)
    return replace(rows, point=point)


def build_heuristic_envelope(terrains: TerrainDistribution) -> Envelope:
    """Return an expert's bounds (X. Lin, UCLA 2022): toe workspaces and known force profiles.

    Walls: pressure 0 to 0.9, level shear within 0.3, upright shear 0 to 0.4. Ground: pressure 0 to
    0.5, shear within 0.15.
    """
    legs = terrains.legs
    reach = (terrains.jitter + terrains.half_size) / legs.length
    p = legs.stance / legs.length
    side = np.sign(terrains.normal[:, 0])
    wall = bool(np.abs(terrains.normal[:, 2]).max() < 0.5)
    low, high = np.empty_like(p), np.empty_like(p)
    if wall:
        low[:], high[:] = [0.0, -0.3, 0.0], [0.0, 0.3, 0.4]
        low[:, 0], high[:, 0] = np.where(side > 0, 0.0, -0.9), np.where(side > 0, 0.9, 0.0)
    else:
        low[:], high[:] = [-0.15, -0.15, 0.0], [0.15, 0.15, 0.5]
    return Envelope(np.hstack([p - reach, low]), np.hstack([p + reach, high]))


@dataclass(frozen=True)
class Validation:
    """One row of Table 5.2, and what stands behind it."""

    feasible: float  # P1 correct feasible
    infeasible: float  # P1 correct infeasible
    convex: float  # P1 -> P2 convex, share of the feasible terrains
    nlp: float  # P1 -> P2 by NLP
    feasible_count: int
    infeasible_count: int

    @property
    def product(self) -> float:
        """P1 correct feasible times correct infeasible."""
        return self.feasible * self.infeasible


@dataclass(frozen=True)
class TheoremConditions:
    """The theorem's conditions, measured: shares of terrains for which they hold."""

    meets: float  # (1) the box holds a point of the feasible set (a lower bound: IPOPT looked)
    excludes: float  # (2) of infeasible terrains, none of P-bar's solutions lies in the box
    projects: float  # (3) of feasible terrains with a P1 point, that point's toes carry forces


@dataclass(frozen=True)
class Measured:
    """All that held-out rows tell of a set of envelopes."""

    validation: Validation
    conditions: TheoremConditions


def measure(envelopes: EnvelopeSet, rows: TerrainDataset, prepared: list[FirstStage]) -> Measured:
    """Return the validation table's row, and conditions 1 to 3 of the union of boxes.

    With several envelopes P1 is feasible where it is with one. (2) is by linear programs, exact.
    """
    called: list[bool] = []
    convex, nlp, meets, excludes, projects = [], [], [], [], []
    for k, stage in enumerate(prepared):
        first_stage_points = [
            (e, stage.solve(e.lower, e.upper, (e.lower + e.upper) / 2)) for e in envelopes
        ]
        points = [(e, x) for e, x in first_stage_points if x is not None]
        called.append(bool(points))
        if not rows.feasible[k]:
            excludes.append(not any(contains_linear_point(stage, e) for e in envelopes))
            continue
        projected = [(e, stage.convex(x)) for e, x in points]
        hits = [(e, x) for e, x in projected if x is not None]
        convex.append(bool(hits))
        nlp.append(bool(hits) or any(stage.nlp(x) is not None for _, x in points))
        inside = any(e.contains(x[stage.factors][None])[0] for e, x in hits)
        meets.append(inside or any(contains_point(stage, e, x) for e, x in points))
        if points:
            projects.append(len(hits) == len(points))
    is_feasible = np.array(called)
    return Measured(
        Validation(
            float(is_feasible[rows.feasible].mean()),
            float((~is_feasible[~rows.feasible]).mean()),
            float(np.mean(convex)),
            float(np.mean(nlp)),
            int(rows.feasible.sum()),
            int((~rows.feasible).sum()),
        ),
        TheoremConditions(
            float(np.mean(meets)),
            float(np.mean(excludes)),
            float(np.mean(projects)) if projects else 0.0,
        ),
    )


def select_training_points(rows: TerrainDataset) -> tuple[Array, Array]:
    """Return feasible and infeasible points, (n, N, 6) and (m, N, 6)."""
    return rows.point[rows.feasible], rows.point[~rows.feasible]
