"""Cutting planes for link lengths: outer approximation of balls, on demand.

A link that a solution makes too long gets the tangent plane across it, which no link of its length
violates. The fixed planes around each ball allow a link to be a quarter longer, and arms could then
reach beyond their length.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.problem import ConsensusProblem

LENGTH_ROWS = "kinematics.forward"  # block of rows that the cuts belong to
LENGTH_TOLERANCE = 0.01  # fraction by which a link may be longer


class LinkLengthCuts:
    """Cuts on link lengths in a HiGHS model, relaxed and restored together."""

    def __init__(self, problem: ConsensusProblem, points: IntArray, solver: Any) -> None:
        """Initialise without cuts.

        Args:
            problem: The problem.
            points: Columns of the ends of links (K + 1, L, 5, 3).
            solver: The HiGHS model.
        """
        self._link_lengths, self._points, self._solver = problem.link_lengths, points, solver
        self._rows: list[int] = []
        self._upper: list[float] = []
        self._is_relaxed = False

    def add_cuts(self, x: Array) -> int:
        """Add a cut for each link that x makes too long, and return their number."""
        if self._is_relaxed:
            return 0
        differences = np.diff(x[self._points], axis=2)  # (K + 1, L, 4, 3)
        length = np.linalg.norm(differences, axis=-1)
        too_long = np.argwhere(length > (1 + LENGTH_TOLERANCE) * self._link_lengths)
        for knot, module, link in too_long:
            direction = differences[knot, module, link] / length[knot, module, link]
            ends = self._points[knot, module, link + 1], self._points[knot, module, link]
            self._rows.append(self._solver.getNumRow())
            self._upper.append(float(self._link_lengths[link]))
            self._solver.addRow(
                -np.inf,
                self._upper[-1],
                6,
                np.concatenate(ends).astype(np.int32),
                np.concatenate([direction, -direction]),
            )
        return len(too_long)

    def relax(self) -> None:
        """Remove the upper bounds of all cuts."""
        self._is_relaxed = True
        self._set_upper_bounds(np.full(len(self._rows), np.inf))

    def restore(self) -> None:
        """Restore the upper bounds of all cuts."""
        self._is_relaxed = False
        self._set_upper_bounds(np.array(self._upper))

    def _set_upper_bounds(self, upper: Array) -> None:
        """Set the upper bounds of all cuts."""
        if rows := self._rows:
            lower = np.full(len(rows), -np.inf)
            self._solver.changeRowsBounds(len(rows), np.array(rows, np.int32), lower, upper)
