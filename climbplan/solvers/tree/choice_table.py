"""One choice as intervals: every alternative seen along row directions of the choice.

Along a direction d an alternative takes values in [lower, upper]. The hull of a set of alternatives
is bounded by the least lower and the largest upper value of its members, so that a branch of the
search that allows only some alternatives changes nothing but bounds of the same rows.

Few alternatives are seen along all directions that any of them states. Many (a mesh of 320
triangles states some 900) are seen along a few that are spread evenly: enough for hulls of sets.
What an alternative itself states stands in `own` in any case, and is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from climbplan.arrays import Array, BoolArray
from climbplan.program.instance import Choice
from climbplan.program.polytope import Polytope

UNBOUNDED = 1e30  # no bound, in DAQP's terms
_PARALLEL = 1e-9  # unit rows closer than this are the same direction
_OFF = 1e-6  # stated vertices further outside their own polytope are not trusted
_FEW = 32  # alternatives up to which all ways to divide them are listed
_TABULATED = 30_000  # R D D up to which alternatives are seen along all directions
_SPREAD = 16  # directions of hulls otherwise
_PLANES = 8  # normals of planes come first unless there are more
_HULLS, _SPLIT_BYTES = 50_000, 64e6  # remembered; more are forgotten and made anew

Mask = int  # set of alternatives, one bit each


@dataclass(frozen=True)
class Splits:
    """Ways to divide a set of alternatives, the children of all ways one after another."""

    children: tuple[Mask, ...]
    first: NDArray[np.intp]  # (K,) where the children of each way start
    lower: Array  # (sum of children, D) hulls
    upper: Array


@dataclass(frozen=True)
class OwnRows:
    """What R alternatives state: lower <= directions[index] y <= upper, padded with no bounds."""

    directions: Array  # (A, d) unit rows
    index: NDArray[np.intp]  # (R, q)
    lower: Array  # (R, q)
    upper: Array  # (R, q)


@dataclass(frozen=True)
class ChoiceTable:
    """Intervals of R alternatives along D directions."""

    directions: Array  # (D, d) unit rows
    lower: Array  # (R, D), -UNBOUNDED where nothing is known
    upper: Array  # (R, D)
    own_lower: Array  # (R, D) intervals by stated rows alone
    own_upper: Array
    own: OwnRows
    complete: bool  # the directions are all that are stated
    bounded: bool  # vertices of all alternatives are known
    empty: BoolArray  # (R,) alternatives that are known to hold no point
    _hulls: dict[Mask, tuple[Array, Array]] = field(default_factory=dict, repr=False)
    _splits: dict[Mask, Splits] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, alternatives: tuple[Polytope, ...], every_row: bool = False) -> ChoiceTable:
        """The table of a choice among polytopes of one dimension d.

        every_row: along all directions, however many there are.
        """
        stated = _stated(alternatives)
        own, empty = stated.own, stated.empty
        known = [p.vertices is not None and _outside(p) <= _OFF for p in alternatives]
        bounded = all(known)
        count, size = len(alternatives), len(own.directions)
        complete = every_row or not bounded or count * size**2 <= _TABULATED
        kept = np.arange(size) if complete else _spread(own.directions, stated.planes)
        directions = own.directions[kept]
        shape = (count, len(kept))
        lower, upper = np.full(shape, -UNBOUNDED), np.full(shape, UNBOUNDED)
        own_lower, own_upper = lower.copy(), upper.copy()
        for k, polytope in enumerate(alternatives):
            if not known[k]:
                continue
            along = np.asarray(polytope.vertices) @ directions.T
            lower[k], upper[k] = along.min(axis=0), along.max(axis=0)
        place = np.full(size, -1)
        place[kept] = np.arange(len(kept))
        at = place[own.index]
        r, q = np.nonzero(at >= 0)
        np.maximum.at(own_lower, (r, at[r, q]), own.lower[r, q])
        np.minimum.at(own_upper, (r, at[r, q]), own.upper[r, q])
        # A stated row is exact; what the vertices say on the other side of it still holds.
        lower, upper = np.maximum(lower, own_lower), np.minimum(upper, own_upper)
        empty |= (lower > upper + _OFF).any(axis=1)
        return cls(
            directions=directions,
            lower=lower,
            upper=upper,
            own_lower=own_lower,
            own_upper=own_upper,
            own=own,
            complete=complete,
            bounded=bounded,
            empty=empty,
        )

    @property
    def count(self) -> int:
        """R."""
        return len(self.lower)

    @property
    def everything(self) -> Mask:
        """The set of all alternatives."""
        return (1 << self.count) - 1

    def mask(self, allowed: BoolArray) -> Mask:
        """The set of the alternatives that are flagged, (R,) or longer."""
        return int.from_bytes(np.packbits(allowed, bitorder="little").tobytes(), "little")

    def members(self, mask: Mask) -> NDArray[np.intp]:
        """Indices of the alternatives in a set."""
        return np.flatnonzero(flags_of(mask, self.count))

    def hull(self, mask: Mask) -> tuple[Array, Array]:
        """Lower and upper bounds (D,) of the union of a set along every direction.

        A single alternative is bounded by its own rows alone if all of them are here: others would
        only repeat them.
        """
        known = self._hulls.get(mask)
        if known is None:
            members = self.members(mask)
            if len(members) == 1 and self.complete:
                known = self.own_lower[members[0]], self.own_upper[members[0]]
            else:
                known = self.lower[members].min(axis=0), self.upper[members].max(axis=0)
            if len(self._hulls) >= _HULLS:
                self._hulls.clear()
            self._hulls[mask] = known
        return known

    @property
    def listed(self) -> bool:
        """Whether the alternatives are few enough to list all ways to divide them."""
        return self.complete and (self.count <= _FEW or not self.bounded)

    def splits(self, mask: Mask) -> Splits:
        """Candidate ways to branch on a set of at least two alternatives.

        With known vertices: each alternative against the rest, and the sets below and above every
        threshold along every direction (of two disjoint polygons one edge separates them). Without
        vertices a hull says nothing, so each alternative becomes a child of its own.
        """
        if mask not in self._splits:
            members = [int(r) for r in self.members(mask)]
            ways = self._halves(mask, members) if self.bounded else [[1 << r for r in members]]
            children = [child for way in ways for child in way]
            hulls = [self.hull(child) for child in children]
            held = 16.0 * len(children) * len(self.directions)
            if len(self._splits) * held > _SPLIT_BYTES:
                self._splits.clear()
            self._splits[mask] = Splits(
                tuple(children),
                np.cumsum([0, *(len(way) for way in ways[:-1])]),
                np.array([low for low, _ in hulls]),
                np.array([high for _, high in hulls]),
            )
        return self._splits[mask]

    def _halves(self, mask: Mask, members: list[int]) -> list[list[Mask]]:
        halves: dict[frozenset[Mask], None] = {}
        for r in members:
            halves.setdefault(frozenset((1 << r, mask & ~(1 << r))))
        middle = self.lower[members] + self.upper[members]
        for order in np.argsort(middle, axis=0, kind="stable").T:
            below = 0
            for index in order[:-1]:
                below |= 1 << members[int(index)]
                halves.setdefault(frozenset((below, mask & ~below)))
        return [sorted(half) for half in halves]


def flags_of(mask: Mask, count: int) -> BoolArray:
    """A set as flags (count,)."""
    packed = np.frombuffer(mask.to_bytes((count + 7) // 8, "little"), np.uint8)
    return np.unpackbits(packed, count=count, bitorder="little").view(np.bool_)


def choice_tables(choices: Sequence[Choice], every_row: bool = False) -> list[ChoiceTable]:
    """One table for each choice, shared between choices of the same alternatives."""
    known: dict[tuple[int, ...], ChoiceTable] = {}
    tables = []
    for choice in choices:
        key = tuple(id(p) for p in choice.alternatives)
        if key not in known:
            known[key] = ChoiceTable.of(choice.alternatives, every_row)
        tables.append(known[key])
    return tables


@dataclass(frozen=True)
class _Stated:
    own: OwnRows
    planes: NDArray[np.intp]  # directions that are the normal of an alternative's plane
    empty: BoolArray  # (R,) a row without coefficients fails


def _stated(alternatives: tuple[Polytope, ...]) -> _Stated:
    """All rows of all alternatives, as intervals along different directions."""
    sizes = [len(p.b) + len(p.c) for p in alternatives]
    d = alternatives[0].dimension
    rows = np.concatenate([np.zeros((0, d)), *(m for p in alternatives for m in (p.A, p.C))])
    low = np.concatenate([v for p in alternatives for v in (np.full(len(p.b), -np.inf), p.c)])
    high = np.concatenate([v for p in alternatives for v in (p.b, p.c)])
    of = np.repeat(np.arange(len(alternatives)), sizes)
    length = np.linalg.norm(rows, axis=1)
    short = length < _PARALLEL
    empty = np.zeros(len(alternatives), bool)
    empty[of[short & ((low > _PARALLEL) | (high < -_PARALLEL))]] = True
    rows, low, high, of = (part[~short] for part in (rows, low, high, of))
    length = length[~short]
    rows = rows / length[:, None]
    low, high = low / length, high / length
    place, sign, directions = _directions(rows)
    low, high = np.where(sign > 0, low, -high), np.where(sign > 0, high, -low)
    low, high = np.maximum(low, -UNBOUNDED), np.minimum(high, UNBOUNDED)
    # Several rows of an alternative along one direction are one interval.
    key, inverse = np.unique(of * max(len(directions), 1) + place, return_inverse=True)
    lower, upper = np.full(len(key), -UNBOUNDED), np.full(len(key), UNBOUNDED)
    np.maximum.at(lower, inverse, low)
    np.minimum.at(upper, inverse, high)
    holder, along = np.divmod(key, max(len(directions), 1))
    numbers = np.bincount(holder, minlength=len(alternatives))
    column = np.arange(len(key)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
    shape = (len(alternatives), int(numbers.max(initial=0)))
    index = np.zeros(shape, np.intp)
    own_lower, own_upper = np.full(shape, -UNBOUNDED), np.full(shape, UNBOUNDED)
    index[holder, column] = along
    own_lower[holder, column], own_upper[holder, column] = lower, upper
    planes = np.unique(along[upper - lower <= _PARALLEL])
    return _Stated(OwnRows(directions, index, own_lower, own_upper), planes, empty)


def _directions(rows: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Unit rows as index and sign among different directions, numbered as they first appear.

    Rows that are the same to the last digit, of which parallel panels have many, are one.
    """
    if not len(rows):
        return np.empty(0, np.intp), np.ones(0, np.intp), rows.copy()
    _, first, same = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they appear
    number = np.empty(len(order), np.intp)
    number[order] = np.arange(len(order))
    place, sign, directions = _different(rows[first[order]])
    which = number[same.reshape(-1)]
    return place[which], sign[which], directions


def _different(rows: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """The same for unit rows that all differ."""
    place, sign = np.empty(len(rows), np.intp), np.ones(len(rows), np.intp)
    tree = cKDTree(rows)
    near = {
        turn: tree.query_ball_point(turn * rows, _PARALLEL, p=np.inf, return_sorted=True)
        for turn in (1, -1)
    }
    number: dict[int, int] = {}  # of the row that a direction first appeared in
    for k in range(len(rows)):
        for turn in (1, -1):
            first = next((i for i in near[turn][k] if i < k and i in number), None)
            if first is not None:
                place[k], sign[k] = number[first], turn
                break
        else:
            number[k] = place[k] = len(number)
    return place, sign, rows[list(number)]


def _spread(directions: Array, planes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Few directions, normals of planes first, each next one furthest from parallel to all."""
    kept = [int(p) for p in planes] if 0 < len(planes) <= _PLANES else [0]
    nearest = np.abs(directions @ directions[kept].T).max(axis=1)
    while len(kept) < min(_SPREAD, len(directions)):
        new = int(np.argmin(nearest))
        kept.append(new)
        nearest = np.maximum(nearest, np.abs(directions @ directions[new]))
    return np.sort(np.array(kept))


def _outside(polytope: Polytope) -> float:
    assert polytope.vertices is not None
    return max((polytope.violation(v) for v in polytope.vertices), default=np.inf)
