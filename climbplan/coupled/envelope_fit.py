"""Fitting envelopes to labelled terrains, and the validation table of chapter 5.2.3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from climbplan.coupled.box_tests import holds_linear_point, holds_point
from climbplan.coupled.first_stage import FirstStage, Manner
from climbplan.coupled.recentring import nearest_point
from climbplan.coupled.rows import Rows
from climbplan.coupled.statement import PostureStatement
from climbplan.coupled.terrains import TerrainDistribution
from climbplan.learning.envelope_box import Envelope, EnvelopeSet
from climbplan.program.polytope import Array

Method = Literal["clustering", "genetic", "heuristic"]
_RECENTRINGS = 2
_LEAST_SPREAD = 0.02  # of a factor, below which it counts as this


def stages(statement: PostureStatement, rows: Rows, manner: Manner) -> list[FirstStage]:
    """P1 on every terrain, ready for any envelope."""
    return [FirstStage.of(statement, rows.patches(k), manner) for k in range(len(rows.terrain))]


def recentred(
    rows: Rows,
    prepared: list[FirstStage],
    report: Callable[[float], None] | None = None,
    times: int = _RECENTRINGS,
) -> Rows:
    """The rows with each feasible point moved, within its feasible set, towards the median."""
    point = rows.point.copy()
    which = np.flatnonzero(rows.feasible)
    for turn in range(times):
        centre = np.median(point[which], axis=0)
        weight = 1.0 / np.maximum(point[which].std(axis=0), _LEAST_SPREAD) ** 2
        for done, k in enumerate(which):
            found = nearest_point(prepared[k], point[k], centre, weight)
            point[k] = point[k] if found is None else found
            if report is not None:
                report((turn + (done + 1) / len(which)) / times)
    return replace(rows, point=point)


def heuristic(terrains: TerrainDistribution) -> Envelope:
    """The published expert's bounds: workspaces for toes, known force profiles for forces.

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


def validate(envelopes: EnvelopeSet, rows: Rows, prepared: list[FirstStage]) -> Validation:
    """P1 and P2 on held-out rows; with several envelopes the first that has a solution counts."""
    called: list[bool] = []
    convex: list[bool] = []
    nlp: list[bool] = []
    for k, stage in enumerate(prepared):
        points = [
            x
            for e in envelopes
            if (x := stage.solve(e.lower, e.upper, (e.lower + e.upper) / 2)) is not None
        ]
        called.append(bool(points))
        if rows.feasible[k]:
            projected = any(stage.convex(x) is not None for x in points)
            convex.append(projected)
            nlp.append(projected or any(stage.nlp(x) is not None for x in points))
    is_feasible = np.array(called)
    return Validation(
        float(is_feasible[rows.feasible].mean()),
        float((~is_feasible[~rows.feasible]).mean()),
        float(np.mean(convex)),
        float(np.mean(nlp)),
        int(rows.feasible.sum()),
        int((~rows.feasible).sum()),
    )


@dataclass(frozen=True)
class Conditions:
    """The theorem's conditions, measured: shares of terrains for which they hold."""

    meets: float  # (1) the box holds a point of the feasible set (a lower bound: IPOPT looked)
    excludes: float  # (2) of infeasible terrains, none of P-bar's solutions lies in the box
    projects: float  # (3) of feasible terrains with a P1 point, that point's toes carry forces


def conditions(envelopes: EnvelopeSet, rows: Rows, prepared: list[FirstStage]) -> Conditions:
    """Conditions 1 to 3 on rows, of the union of boxes; (2) by linear programs that are exact."""
    meets, excludes, projects = [], [], []
    for k, stage in enumerate(prepared):
        if rows.feasible[k]:
            meets.append(any(holds_point(stage, e) for e in envelopes))
            points = [
                x
                for e in envelopes
                if (x := stage.solve(e.lower, e.upper, (e.lower + e.upper) / 2)) is not None
            ]
            if points:
                projects.append(all(stage.convex(x) is not None for x in points))
        else:
            excludes.append(not any(holds_linear_point(stage, e) for e in envelopes))
    share = float(np.mean(projects)) if projects else 0.0
    return Conditions(float(np.mean(meets)), float(np.mean(excludes)), share)


def training_points(rows: Rows) -> tuple[Array, Array]:
    """Feasible and infeasible points, (n, N, 6) and (m, N, 6)."""
    return rows.point[rows.feasible], rows.point[~rows.feasible]
