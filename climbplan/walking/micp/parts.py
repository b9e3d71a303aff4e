"""Parts of motions: by contacts of the first intervals, and by halves of where these can be.

Heads draw ranges of all motions of a part, so that those of motions that begin alike are narrower
than those of all. Where contacts are decided what is left are products within ranges: halving one
of these, as spatial branching does, and drawing the others anew is what shuts them up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.micp.heads import SHORTEST, Stated, least_of_head
from climbplan.walking.micp.kept import Decision, Kept
from climbplan.walking.micp.ranges import Box
from climbplan.walking.micp.statement import Relaxation
from climbplan.walking.task.task import ANGLES

_FIRST = 2  # intervals whose contacts make parts first
_FEW = 8  # parts that a whole tube makes at most
_EARLY = 4  # intervals that decide most: the start is given, and errors of products add up
_TURNED = 2  # the first knot whose attitude is not given
_ARMS = 2  # pairs of ranges of arms that are tried, those first that matter most
_LESS = 5.0 / 6.0  # what the worse half counts, of two (Achterberg 2007)


@dataclass(frozen=True)
class Part:
    """Motions of a statement that a box holds."""

    stated: Stated
    images: bool  # of two that mirror one is enough
    box: Box | None = None  # nothing is known
    bound: float = 0.0
    decided: int = 0  # intervals whose contacts are
    head: int = SHORTEST  # intervals of the head that is drawn next
    later: float | None = None  # what those after it cost, at least


@dataclass(frozen=True)
class Opened:
    """What linear programs tell of a tube: its part, and the program of its ranges."""

    part: Part
    program: Relaxation


def early_of(stated: Stated) -> int:
    """How many intervals are early ones: fewer than all."""
    return min(_EARLY, stated.task.knots - 1)


def by_contacts(
    part: Part, program: Relaxation, sag: float, goes_on: Callable[[], bool]
) -> list[Part] | None:
    """A part by contacts of its next intervals, without those where nothing is cheap enough.

    None of a whole tube whose first contacts make too many: these matter little.

    Each open contact is decided both ways, in the order of knots, in the program as it stays in
    the solver; sag: as of `Kept`. What time does not suffice for is left open.
    """
    kept, box = Kept(program, sag, part.images), program.box
    early = early_of(part.stated)
    early = min(_FIRST, early) if part.decided < _FIRST else early
    place = {int(row): at for at, row in np.ndenumerate(program.rows)}
    found, stack = list[Part](), [(part.bound, tuple[Decision, ...]())]
    kept.begin()
    while stack:
        bound, made = stack.pop()
        x: Array | None = None
        if asked := goes_on():
            kept.decide(made)
            point = kept.solve(np.inf)
            if point is None:
                continue
            bound, x = max(bound, point.bound), point.x
        decided = {place[one.place]: one.value for one in made}
        open_ = box.stands_low < box.stands_high
        open_[early:] = False
        for at in decided:
            open_[at] = False
        if not asked or not open_.any():
            done = early if asked else part.decided
            held = _deciding(box, decided)
            one = replace(part, box=held, bound=bound, decided=done, later=None)
            found.append(replace(one, head=early_of(part.stated)))
            if part.decided == 0 and len(found) > _FEW:
                return None
            continue
        n = int(np.flatnonzero(open_.any(axis=1))[0])
        stands = program.standing(x)[n] if x is not None else np.full(open_.shape[1], 0.5)
        leg = int(np.where(open_[n], np.minimum(stands, 1.0 - stands), -1.0).argmax())
        row = int(program.rows[n, leg])
        likely = float(stands[leg] >= 0.5)
        stack += [(bound, (*made, Decision(True, row, way))) for way in (1.0 - likely, likely)]
    return found


def _deciding(box: Box, decided: dict[tuple[int, ...], float]) -> Box:
    low, high = box.stands_low.copy(), box.stands_high.copy()
    for at, stands in decided.items():
        low[at] = high[at] = stands
    return replace(box, stands_low=low, stands_high=high)


@dataclass(frozen=True)
class Halves:
    """A part in two, without those that have no motion; none if there is nothing to halve."""

    parts: tuple[Part, ...]
    gain: float  # that their heads cost more than that of both, the worse one's for the most part


def halves(part: Part) -> Halves | None:
    """A part in two, by the range whose halves raise what the head costs at least most."""
    box, later, most = part.box, part.later or 0.0, part.stated.most
    assert box is not None

    def least(held: Box) -> float:
        return min(least_of_head(part.stated, held, early_of(part.stated), later), most)

    known = least(box)
    best, found = -np.inf, None
    for pair in _pairs(part.stated, box):
        bounds = [least(one) for one in pair]
        score = _LESS * min(bounds) + (1.0 - _LESS) * max(bounds)
        if score > best:
            parts = tuple(
                replace(part, box=one, bound=max(part.bound, bound))
                for one, bound in zip(pair, bounds, strict=True)
                if bound < most
            )
            best, found = score, Halves(parts, score - known)
    return found


def _pairs(stated: Stated, box: Box) -> Iterator[tuple[Box, Box]]:
    """Halves of attitudes, and of arms of legs that stand, at early knots."""
    tube, last = box.tube(stated.tube), early_of(stated)
    for n in range(_TURNED, last):
        for k in range(3):
            if tube.angles_half[n, k] > 1e-3:
                at = (n, ANGLES.start + k)
                yield _cut(box, "low", "high", at, float(tube.angles[n, k]))
    width = np.where(box.stands_low[:last, :, None] > 0, (box.arm_high - box.arm_low)[:last], 0.0)
    width = np.where(np.isfinite(width), width, 0.0)
    force = (box.force_high - box.force_low)[:last, :, 1::-1]  # across it
    for place in np.argsort(-(width * force), axis=None)[:_ARMS]:
        n, leg, k = (int(one) for one in np.unravel_index(int(place), width.shape))
        if width[n, leg, k] > 1e-3:
            middle = 0.5 * float(box.arm_low[n, leg, k] + box.arm_high[n, leg, k])
            yield _cut(box, "arm_low", "arm_high", (n, leg, k), middle)


def _cut(box: Box, low: str, high: str, at: tuple[int, ...], middle: float) -> tuple[Box, Box]:
    """What is below and what is above the middle of a range."""
    below, above = getattr(box, high).copy(), getattr(box, low).copy()
    below[at] = above[at] = middle
    return replace(box, **{high: below}), replace(box, **{low: above})
