"""Parts of motions: each contact that is decided makes two, which together are all of them.

Ranges that heads draw are of all motions of a part, so that those of two that begin differently
are narrower than those of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.walking.micp.heads import Stated
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.task import Array


@dataclass(frozen=True)
class Part:
    """Motions of a statement that a box holds."""

    stated: Stated
    images: bool  # of two that mirror one is enough
    box: Box | None = None  # nothing is known

    def by_contact(self, opened: Opened) -> tuple[Part, Part] | None:
        """With a contact and without it, for the earliest that is open; None if all are decided.

        Of legs at that knot it is the one that the relaxed program has by half the most.
        """
        known = opened.program.box
        free = known.stands_low < known.stands_high
        if not free.any():
            return None
        n = int(np.flatnonzero(free.any(axis=1))[0])
        stands = np.full(free.shape, 0.5)
        if opened.x is not None:
            stands = opened.program.standing(opened.x)
        leg = int(np.where(free[n], np.minimum(stands[n], 1.0 - stands[n]), -1.0).argmax())
        return self._with(known, n, leg, 0.0), self._with(known, n, leg, 1.0)

    def _with(self, known: Box, n: int, leg: int, stands: float) -> Part:
        low, high = known.stands_low.copy(), known.stands_high.copy()
        low[n, leg] = high[n, leg] = stands
        return replace(self, box=replace(known, stands_low=low, stands_high=high))


@dataclass(frozen=True)
class Opened:
    """What linear programs tell of a part: the program of its ranges, and where it wants to be."""

    program: Relaxation
    x: Array | None  # unless time was over
