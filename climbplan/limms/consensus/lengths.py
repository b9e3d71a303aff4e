"""Links no longer than they are: planes round a ball are loose, so that answers add their own.

Outer approximation: a link that an answer makes too long gets the plane across it, which no link
of its length breaks. Seven pairs of planes let one be a quarter longer, an arm then reaches what
no arm does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.consensus.setting import Setting

LENGTHS = "kinematics.points"  # block of rows that the planes belong to
LONGER = 0.01  # share by which a link may be longer


class Lengths:
    """Planes across links in a HiGHS model, which are loosened and restored as one."""

    def __init__(self, setting: Setting, points: IntArray, solver: Any) -> None:
        """points: (K + 1, L, 5, 3) columns of the ends of links."""
        self._links, self._points, self._solver = setting.links, points, solver
        self._rows: list[int] = []
        self._most: list[float] = []
        self._loose = False

    def cut(self, x: Array) -> int:
        """Add a plane for each link that x makes too long; how many there were."""
        if self._loose:
            return 0
        apart = np.diff(x[self._points], axis=2)  # (K + 1, L, 4, 3)
        length = np.linalg.norm(apart, axis=-1)
        long = np.argwhere(length > (1 + LONGER) * self._links)
        for knot, m, link in long:
            way = apart[knot, m, link] / length[knot, m, link]
            ends = self._points[knot, m, link + 1], self._points[knot, m, link]
            self._rows.append(self._solver.getNumRow())
            self._most.append(float(self._links[link]))
            self._solver.addRow(
                -np.inf,
                self._most[-1],
                6,
                np.concatenate(ends).astype(np.int32),
                np.concatenate([way, -way]),
            )
        return len(long)

    def loosen(self) -> None:
        """Let links be of any length."""
        self._loose = True
        self._bound(np.full(len(self._rows), np.inf))

    def restore(self) -> None:
        """Let planes hold again."""
        self._loose = False
        self._bound(np.array(self._most))

    def _bound(self, most: Array) -> None:
        if rows := self._rows:
            least = np.full(len(rows), -np.inf)
            self._solver.changeRowsBounds(len(rows), np.array(rows, np.int32), least, most)
