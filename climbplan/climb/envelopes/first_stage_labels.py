"""What P1 calls labelled terrains, for many sets of envelopes: the genetic search's fitness.

A box that holds a known point of a terrain's feasible set makes P1 feasible there (the theorem's
first condition), so no program is solved for it. Sets of envelopes are shared among processes;
what is answered does not depend on how many there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.envelopes.first_stage import FirstStage, Manner
from climbplan.climb.envelopes.legs import Legs
from climbplan.climb.envelopes.statement import build_posture_statement
from climbplan.climb.envelopes.terrains import LimbPatches
from climbplan.learning.envelope_box import EnvelopeSet, FirstStageLabels


@dataclass(frozen=True)
class LabelledTerrains:
    """n terrains with points that are known to be feasible; plain values for other processes."""

    legs: Legs
    terrain: Array  # (n, p) vectors of patches
    manner: Manner
    known: Array  # (n, m, N, 6) feasible points; NaN where there is none
    token: str  # equal ones are equal terrains

    def prepare_stages(self) -> list[FirstStage]:
        """Return P1 on every terrain, ready for any envelope."""
        statement = build_posture_statement(self.legs)
        return [
            FirstStage.of(statement, LimbPatches.from_vector(row), self.manner)
            for row in self.terrain
        ]


def build_labeller(
    terrains: LabelledTerrains, prepared: list[FirstStage], jobs: int = 1
) -> FirstStageLabels:
    """Return whether P1 has a solution on some terrains, for sets of envelopes, by `jobs`
    processes.
    """
    if jobs == 1:
        return lambda sets, rows: [label_rows(prepared, terrains.known, e, rows) for e in sets]

    def labels(sets: Sequence[EnvelopeSet], rows: IntArray) -> list[BoolArray]:
        chunks = np.array_split(np.arange(len(sets)), min(jobs, len(sets)))
        from joblib import Parallel, delayed

        work = (delayed(_label_share)(terrains, [sets[k] for k in chunk], rows) for chunk in chunks)
        return [mask for masks in Parallel(n_jobs=jobs)(work) for mask in masks]

    return labels


def label_rows(
    prepared: list[FirstStage], feasible_points: Array, envelopes: EnvelopeSet, rows: IntArray
) -> BoolArray:
    """Return which of the rows P1 calls feasible with one of the envelopes."""
    feasible = np.zeros(len(rows), bool)
    for e in envelopes:
        points = feasible_points[rows]
        inside = (points >= e.lower) & (points <= e.upper)  # NaN is in no box
        feasible |= np.any(inside.all(axis=(2, 3)), axis=1)
    for row_index in np.flatnonzero(~feasible):
        stage = prepared[rows[row_index]]
        feasible[row_index] = any(stage.solve(e.lower, e.upper) is not None for e in envelopes)
    return feasible


_prepared: dict[str, list[FirstStage]] = {}  # of a worker process: one set of terrains at a time


def _label_share(
    terrains: LabelledTerrains, sets: list[EnvelopeSet], rows: IntArray
) -> list[BoolArray]:
    """Return a worker's share."""
    if terrains.token not in _prepared:
        _prepared.clear()
        _prepared[terrains.token] = terrains.prepare_stages()
    return [label_rows(_prepared[terrains.token], terrains.known, e, rows) for e in sets]
