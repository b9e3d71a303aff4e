"""One choice as intervals: every alternative projected onto row directions of the choice.

Along a direction d an alternative takes values in [lower, upper]. The hull of a set of alternatives
is bounded by the smallest lower and the largest upper value of its members. A branch of the search
that allows only some alternatives therefore changes nothing but bounds of the same rows.

Few alternatives are projected onto all directions of their rows. Many (a mesh of 320 triangles has
some 900) are projected onto a few directions that are spread evenly, which suffices for hulls of
sets. The exact rows of each alternative are stored in `own` in any case.
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
_VERTEX_TOLERANCE = 1e-6  # stated vertices further outside their own polytope are ignored
_MAX_LISTED = 32  # largest number of alternatives of which all divisions are listed
_MAX_TABLE_SIZE = 30_000  # R D D up to which alternatives are projected onto all directions
_NUM_DIRECTIONS = 16  # number of directions of hulls otherwise
_MAX_PLANES = 8  # largest number of plane normals that come first among these
_MAX_HULLS, _MAX_SPLIT_BYTES = 50_000, 64e6  # cache limits

Mask = int  # set of alternatives, one bit each


@dataclass(frozen=True)
class Divisions:
    """Divisions of a set of alternatives, the children of all divisions one after another."""

    children: tuple[Mask, ...]
    first: NDArray[np.intp]  # (K,) first child of each division
    lower: Array  # (sum of children, D) hulls
    upper: Array


@dataclass(frozen=True)
class ExactRows:
    """Rows lower <= directions[index] y <= upper of R alternatives, padded with infinite bounds."""

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
    exact_lower: Array  # (R, D) intervals by stated rows alone
    exact_upper: Array
    exact: ExactRows
    is_complete: bool  # whether these are the directions of all stated rows
    is_bounded: bool  # whether the vertices of all alternatives are known
    is_empty: BoolArray  # (R,) alternatives that are known to contain no point
    _hulls: dict[Mask, tuple[Array, Array]] = field(default_factory=dict, repr=False)
    _splits: dict[Mask, Divisions] = field(default_factory=dict, repr=False)

    @classmethod
    def build(cls, alternatives: tuple[Polytope, ...], every_row: bool = False) -> ChoiceTable:
        """Build the table of a choice among polytopes of one dimension d.

        Args:
            alternatives: The polytopes.
            every_row: Whether to use all directions, however many there are.
        """
        stated = _collect_rows(alternatives)
        exact, empty = stated.exact, stated.is_empty
        has_vertices = [
            p.vertices is not None and _measure_vertex_error(p) <= _VERTEX_TOLERANCE
            for p in alternatives
        ]
        bounded = all(has_vertices)
        count, size = len(alternatives), len(exact.directions)
        complete = every_row or not bounded or count * size**2 <= _MAX_TABLE_SIZE
        selected = np.arange(size) if complete else _select_spread(exact.directions, stated.planes)
        directions = exact.directions[selected]
        shape = (count, len(selected))
        lower, upper = np.full(shape, -UNBOUNDED), np.full(shape, UNBOUNDED)
        own_lower, own_upper = lower.copy(), upper.copy()
        for k, polytope in enumerate(alternatives):
            if not has_vertices[k]:
                continue
            projections = np.asarray(polytope.vertices) @ directions.T
            lower[k], upper[k] = projections.min(axis=0), projections.max(axis=0)
        position = np.full(size, -1)
        position[selected] = np.arange(len(selected))
        position_of_row = position[exact.index]
        r, q = np.nonzero(position_of_row >= 0)
        np.maximum.at(own_lower, (r, position_of_row[r, q]), exact.lower[r, q])
        np.minimum.at(own_upper, (r, position_of_row[r, q]), exact.upper[r, q])
        # A stated row is exact; what the vertices say on the other side of it still holds.
        lower, upper = np.maximum(lower, own_lower), np.minimum(upper, own_upper)
        empty |= (lower > upper + _VERTEX_TOLERANCE).any(axis=1)
        return cls(
            directions=directions,
            lower=lower,
            upper=upper,
            exact_lower=own_lower,
            exact_upper=own_upper,
            exact=exact,
            is_complete=complete,
            is_bounded=bounded,
            is_empty=empty,
        )

    @property
    def count(self) -> int:
        """Number of alternatives R."""
        return len(self.lower)

    @property
    def all_alternatives(self) -> Mask:
        """Set of all alternatives."""
        return (1 << self.count) - 1

    def encode_mask(self, allowed: BoolArray) -> Mask:
        """Return the set of the alternatives that are flagged, (R,) or longer."""
        return int.from_bytes(np.packbits(allowed, bitorder="little").tobytes(), "little")

    def list_members(self, mask: Mask) -> NDArray[np.intp]:
        """Return the indices of the alternatives in a set."""
        return np.flatnonzero(decode_mask(mask, self.count))

    def compute_hull(self, mask: Mask) -> tuple[Array, Array]:
        """Return lower and upper bounds (D,) of the union of a set along every direction.

        A single alternative is bounded by its own rows alone if the table is complete: others would
        only repeat them.
        """
        hull = self._hulls.get(mask)
        if hull is None:
            members = self.list_members(mask)
            if len(members) == 1 and self.is_complete:
                hull = self.exact_lower[members[0]], self.exact_upper[members[0]]
            else:
                hull = self.lower[members].min(axis=0), self.upper[members].max(axis=0)
            if len(self._hulls) >= _MAX_HULLS:
                self._hulls.clear()
            self._hulls[mask] = hull
        return hull

    @property
    def has_listed_divisions(self) -> bool:
        """Return whether the alternatives are few enough to list all divisions."""
        return self.is_complete and (self.count <= _MAX_LISTED or not self.is_bounded)

    def list_divisions(self, mask: Mask) -> Divisions:
        """Return candidate divisions of a set of at least two alternatives.

        With known vertices these are each alternative against the rest, and the sets below and
        above every threshold along every direction (one edge separates two disjoint polygons).
        Without vertices a hull has no bounds, so each alternative becomes a child of its own.
        """
        if mask not in self._splits:
            members = [int(r) for r in self.list_members(mask)]
            divisions = (
                self._list_halves(mask, members) if self.is_bounded else [[1 << r for r in members]]
            )
            children = [child for division in divisions for child in division]
            hulls = [self.compute_hull(child) for child in children]
            num_bytes = 16.0 * len(children) * len(self.directions)
            if len(self._splits) * num_bytes > _MAX_SPLIT_BYTES:
                self._splits.clear()
            self._splits[mask] = Divisions(
                tuple(children),
                np.cumsum([0, *(len(division) for division in divisions[:-1])]),
                np.array([low for low, _ in hulls]),
                np.array([high for _, high in hulls]),
            )
        return self._splits[mask]

    def _list_halves(self, mask: Mask, members: list[int]) -> list[list[Mask]]:
        """Return the divisions into two sets."""
        halves: dict[frozenset[Mask], None] = {}
        for r in members:
            halves.setdefault(frozenset((1 << r, mask & ~(1 << r))))
        center = self.lower[members] + self.upper[members]
        for order in np.argsort(center, axis=0, kind="stable").T:
            below = 0
            for index in order[:-1]:
                below |= 1 << members[int(index)]
                halves.setdefault(frozenset((below, mask & ~below)))
        return [sorted(half) for half in halves]


def decode_mask(mask: Mask, count: int) -> BoolArray:
    """Return a set as flags (count,)."""
    packed = np.frombuffer(mask.to_bytes((count + 7) // 8, "little"), np.uint8)
    return np.unpackbits(packed, count=count, bitorder="little").view(np.bool_)


def build_choice_tables(choices: Sequence[Choice], every_row: bool = False) -> list[ChoiceTable]:
    """Build one table for each choice, shared between choices with the same alternatives."""
    table_of: dict[tuple[int, ...], ChoiceTable] = {}
    tables = []
    for choice in choices:
        key = tuple(id(p) for p in choice.alternatives)
        if key not in table_of:
            table_of[key] = ChoiceTable.build(choice.alternatives, every_row)
        tables.append(table_of[key])
    return tables


@dataclass(frozen=True)
class _DirectionRows:
    """Rows of all alternatives along their different directions."""

    exact: ExactRows
    planes: NDArray[np.intp]  # directions that are the normal of an alternative's plane
    is_empty: BoolArray  # (R,) whether a row without coefficients fails


def _collect_rows(alternatives: tuple[Polytope, ...]) -> _DirectionRows:
    """Collect all rows of all alternatives, as intervals along different directions."""
    sizes = [len(p.b) + len(p.c) for p in alternatives]
    d = alternatives[0].dimension
    rows = np.concatenate([np.zeros((0, d)), *(m for p in alternatives for m in (p.A, p.C))])
    low = np.concatenate([v for p in alternatives for v in (np.full(len(p.b), -np.inf), p.c)])
    high = np.concatenate([v for p in alternatives for v in (p.b, p.c)])
    alternative = np.repeat(np.arange(len(alternatives)), sizes)
    length = np.linalg.norm(rows, axis=1)
    short = length < _PARALLEL
    empty = np.zeros(len(alternatives), bool)
    empty[alternative[short & ((low > _PARALLEL) | (high < -_PARALLEL))]] = True
    rows, low, high, alternative = (array[~short] for array in (rows, low, high, alternative))
    length = length[~short]
    rows = rows / length[:, None]
    low, high = low / length, high / length
    direction, sign, directions = _find_directions(rows)
    low, high = np.where(sign > 0, low, -high), np.where(sign > 0, high, -low)
    low, high = np.maximum(low, -UNBOUNDED), np.minimum(high, UNBOUNDED)
    # Several rows of an alternative along one direction are one interval.
    key, inverse = np.unique(alternative * max(len(directions), 1) + direction, return_inverse=True)
    lower, upper = np.full(len(key), -UNBOUNDED), np.full(len(key), UNBOUNDED)
    np.maximum.at(lower, inverse, low)
    np.minimum.at(upper, inverse, high)
    holder, direction_of_interval = np.divmod(key, max(len(directions), 1))
    num_intervals = np.bincount(holder, minlength=len(alternatives))
    column = np.arange(len(key)) - np.repeat(
        np.cumsum(num_intervals) - num_intervals, num_intervals
    )
    shape = (len(alternatives), int(num_intervals.max(initial=0)))
    index = np.zeros(shape, np.intp)
    own_lower, own_upper = np.full(shape, -UNBOUNDED), np.full(shape, UNBOUNDED)
    index[holder, column] = direction_of_interval
    own_lower[holder, column], own_upper[holder, column] = lower, upper
    planes = np.unique(direction_of_interval[upper - lower <= _PARALLEL])
    return _DirectionRows(ExactRows(directions, index, own_lower, own_upper), planes, empty)


def _find_directions(rows: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return index and sign of unit rows among different directions, in order of appearance.

    Rows that are equal to the last digit are merged first; parallel panels have many.
    """
    if not len(rows):
        return np.empty(0, np.intp), np.ones(0, np.intp), rows.copy()
    _, first, unique_of_row = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they appear
    number = np.empty(len(order), np.intp)
    number[order] = np.arange(len(order))
    index, sign, directions = _match_parallel(rows[first[order]])
    unique_index = number[unique_of_row.reshape(-1)]
    return index[unique_index], sign[unique_index], directions


def _match_parallel(rows: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return index and sign of unit rows that all differ."""
    index, sign = np.empty(len(rows), np.intp), np.ones(len(rows), np.intp)
    tree = cKDTree(rows)
    neighbours = {
        orientation: tree.query_ball_point(
            orientation * rows, _PARALLEL, p=np.inf, return_sorted=True
        )
        for orientation in (1, -1)
    }
    number: dict[int, int] = {}  # of the row that a direction first appeared in
    for k in range(len(rows)):
        for orientation in (1, -1):
            first = next((i for i in neighbours[orientation][k] if i < k and i in number), None)
            if first is not None:
                index[k], sign[k] = number[first], orientation
                break
        else:
            number[k] = index[k] = len(number)
    return index, sign, rows[list(number)]


def _select_spread(directions: Array, planes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Select few directions: normals of planes first, then each the least parallel to all."""
    selected = [int(p) for p in planes] if 0 < len(planes) <= _MAX_PLANES else [0]
    max_cosine = np.abs(directions @ directions[selected].T).max(axis=1)
    while len(selected) < min(_NUM_DIRECTIONS, len(directions)):
        new = int(np.argmin(max_cosine))
        selected.append(new)
        max_cosine = np.maximum(max_cosine, np.abs(directions @ directions[new]))
    return np.sort(np.array(selected))


def _measure_vertex_error(polytope: Polytope) -> float:
    """Return the largest distance of stated vertices outside their own polytope."""
    assert polytope.vertices is not None
    return max((polytope.violation(v) for v in polytope.vertices), default=np.inf)
