"""An instance as the search reads it: scaled cost, all rows in z, choices as intervals of rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable, Mask, choice_tables
from climbplan.solvers.tree.components import SAME, Components, components, equations
from climbplan.solvers.tree.cost_scaling import ScaledCost, scaled_cost
from climbplan.solvers.tree.hulls import choice_hulls, largest_cost
from climbplan.solvers.tree.stacked_choices import StackedChoices

_CERTAIN = 1e9  # where variables are not bounded: costs are taken to stay below this multiple
_CONSTANT = 1e-9  # rows shorter than this in z do not depend on z

Masks = tuple[Mask, ...]  # allowed alternatives of every choice


class OutOfTime(Exception):
    """The time was over before the form was made."""


@dataclass(frozen=True)
class BallForm:
    """|| F_k z + f_k || <= radius_k + relief_k z."""

    F: Array  # (K d, k) rows of ball k are k d ... k d + d - 1
    f: Array  # (K, d)
    radius: Array  # (K,)
    relief: Array | None  # (K, k)
    part: IntArray  # (K,) -1 where a ball couples parts

    def vectors(self, z: Array) -> Array:
        """F z + f, (K, d)."""
        return (self.F @ z).reshape(self.f.shape) + self.f

    def radii(self, z: Array) -> Array:
        """Radii at z, (K,)."""
        return self.radius if self.relief is None else self.radius + self.relief @ z


@dataclass(frozen=True)
class ChoiceGroup:
    """G choices with the same alternatives; their rows stand in one array."""

    table: ChoiceTable
    choices: IntArray  # (G,)
    rows: IntArray  # (G, D) rows of the normal form
    points: IntArray  # (G, d) entries of the choices' points
    part: int


@dataclass(frozen=True)
class ChoicePoints:
    """Points of all choices, one after another: E z + e."""

    E: Array  # (sum d, k)
    e: Array  # (sum d,)
    start: IntArray  # (C + 1,)


@dataclass(frozen=True)
class OwnRowsInZ:
    """What one alternative of a choice states: lower <= rows z <= upper."""

    rows: Array  # (q, k)
    lower: Array  # (q,)
    upper: Array  # (q,)


@dataclass(frozen=True)
class NormalForm:
    """minimise the scaled cost over rows, balls and choices in z."""

    instance: Instance
    cost: ScaledCost
    rows: Array  # (m, k) bounds and rows of the instance, then the directions of the choices
    lower: Array  # (m,)
    upper: Array  # (m,)
    part: IntArray  # (m,) -1 where a row couples parts
    choice_rows: slice
    offset: Array  # (m,) a choice's row takes the value rows z + offset in its table
    varying: BoolArray  # (m,) False for rows that do not depend on z
    groups: tuple[ChoiceGroup, ...]
    tables: tuple[ChoiceTable, ...]  # (C,)
    start: IntArray  # (C + 1,) first row of each choice
    points: ChoicePoints
    stacked: StackedChoices
    choice_part: IntArray  # (C,) -1 where a choice's point does not depend on x
    allowed: BoolArray  # (C, R) alternatives not excluded from the start
    balls: BallForm
    contradiction: str  # why no point is feasible, "" if nothing is known

    @cached_property
    def ceiling(self) -> float:
        """A bound above this proves infeasibility: no feasible point costs more."""
        hulls = choice_hulls(self.instance, list(self.tables), self.stacked)
        cost = largest_cost(self.instance, propagated_box(self.instance, hulls))
        return cost if np.isfinite(cost) else _CERTAIN * (1.0 + abs(self.cost.constant))

    @property
    def size(self) -> int:
        """k."""
        return self.rows.shape[1]

    def x(self, z: Array) -> Array:
        """The instance's variables at z."""
        return np.asarray(self.cost.center + self.cost.X @ z)

    @property
    def root(self) -> Masks:
        """The alternatives not excluded from the start, one set a choice."""
        return self.masks(self.allowed)

    def masks(self, allowed: BoolArray) -> Masks:
        """Sets of alternatives from flags (C, R)."""
        return tuple(t.mask(flags) for t, flags in zip(self.tables, allowed, strict=True))

    def flags(self, masks: Masks) -> BoolArray:
        """Flags (C, R) from sets of alternatives."""
        width = (self.allowed.shape[1] + 7) // 8
        packed = np.frombuffer(b"".join(m.to_bytes(width, "little") for m in masks), np.uint8)
        bits = np.unpackbits(packed.reshape(-1, width), axis=1, bitorder="little")
        return bits[:, : self.allowed.shape[1]].view(np.bool_)

    def choice_bounds(self, masks: Masks) -> tuple[Array, Array]:
        """Bounds of all choice rows for sets of allowed alternatives."""
        return self._shifted([t.hull(m) for t, m in zip(self.tables, masks, strict=True)])

    def bounds_of(self, choices: IntArray, masks: Masks) -> tuple[Array, Array]:
        """Bounds of the rows of some choices, one after another, for one set each."""
        hulls = [self.tables[c].hull(m) for c, m in zip(choices, masks, strict=True)]
        return self._shifted(hulls, self.rows_of(choices))

    def rows_of(self, choices: IntArray) -> IntArray:
        """The rows of some choices, one after another."""
        ranges = [np.arange(self.start[c], self.start[c + 1]) for c in choices]
        return np.concatenate([np.zeros(0, np.int64), *ranges])

    def _shifted(
        self, hulls: list[tuple[Array, Array]], rows: IntArray | slice | None = None
    ) -> tuple[Array, Array]:
        """Intervals in z from intervals of the tables; none where a row does not depend on z."""
        rows = self.choice_rows if rows is None else rows
        low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
        high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
        varying, offset = self.varying[rows], self.offset[rows]
        return (
            np.where(varying & (low > -UNBOUNDED), low - offset, -UNBOUNDED),
            np.where(varying & (high < UNBOUNDED), high - offset, UNBOUNDED),
        )

    def own_rows(self, choice: int, alternative: int) -> OwnRowsInZ:
        """The exact rows of one alternative, for tables whose directions are not complete."""
        own = self.tables[choice].own
        held = (own.lower[alternative] > -UNBOUNDED) | (own.upper[alternative] < UNBOUNDED)
        directions = own.directions[own.index[alternative, held]]
        here = slice(self.points.start[choice], self.points.start[choice + 1])
        rows = directions @ self.points.E[here]
        offset = directions @ self.points.e[here]
        lower, upper = own.lower[alternative, held], own.upper[alternative, held]
        low = np.where(lower > -UNBOUNDED, lower - offset, -UNBOUNDED)
        high = np.where(upper < UNBOUNDED, upper - offset, UNBOUNDED)
        still = np.linalg.norm(rows, axis=1) <= _CONSTANT
        holds = still & (low <= FEASIBILITY) & (high >= -FEASIBILITY)
        rows[still] = 0.0
        low[holds], high[holds] = -UNBOUNDED, UNBOUNDED
        return OwnRowsInZ(rows, low, high)


def normal_form(
    instance: Instance,
    relief: sparse.csr_matrix | None = None,
    late: Callable[[], bool] = lambda: False,
) -> NormalForm:
    """Eliminate equations, scale the cost, and express everything in z.

    relief: (balls, n) adds relief_k x to the radius of ball k, for elastic instances. late: asked
    between steps; raises OutOfTime if it says so.
    """

    def in_time() -> None:
        if late():
            raise OutOfTime

    tables = choice_tables(instance.choices)
    in_time()
    choices = StackedChoices.of(instance.choices, tables, instance.size)
    equal = equations(instance, tables, choices)
    parts = components(instance, equal, choices)
    in_time()
    cost = scaled_cost(
        instance,
        parts,
        equal,
        lambda: propagated_box(instance, choice_hulls(instance, tables, choices)),
    )
    in_time()
    balls = _balls(instance, parts, cost, relief)

    bounded = np.flatnonzero(
        (np.isfinite(instance.lower) | np.isfinite(instance.upper))
        & (instance.upper - instance.lower > SAME)
    )
    open_rows = np.flatnonzero(instance.row_upper - instance.row_lower > SAME)
    unit = sparse.identity(instance.size, format="csr")
    stacked = sparse.vstack([unit[bounded], instance.A[open_rows], choices.rows]).tocsr()
    in_time()
    rows = np.asarray(stacked @ cost.X)
    base = len(bounded) + len(open_rows)
    start = base + choices.start
    m = len(rows)
    shift = np.asarray(stacked @ cost.center)
    offset = shift + np.concatenate([np.zeros(base), choices.offset])
    part = parts.of_rows(stacked)
    part[base:] = np.repeat(parts.choice, np.diff(start))
    points = ChoicePoints(
        np.asarray(choices.E @ cost.X),
        np.asarray(choices.E @ cost.center) + choices.e,
        np.concatenate([[0], np.cumsum([len(c.e) for c in instance.choices])]).astype(np.int64),
    )
    varying = np.linalg.norm(rows, axis=1) > _CONSTANT
    rows[~varying] = 0.0

    lower, upper = np.full(m, -UNBOUNDED), np.full(m, UNBOUNDED)
    lower[:base] = np.concatenate([instance.lower[bounded], instance.row_lower[open_rows]])
    upper[:base] = np.concatenate([instance.upper[bounded], instance.row_upper[open_rows]])
    lower[:base] = np.maximum(lower[:base] - offset[:base], -UNBOUNDED)
    upper[:base] = np.minimum(upper[:base] - offset[:base], UNBOUNDED)
    still = np.flatnonzero(~varying[:base])
    violated = (lower[still] > FEASIBILITY) | (upper[still] < -FEASIBILITY)
    lower[still], upper[still] = -UNBOUNDED, UNBOUNDED

    allowed = _possible(tables, start, offset, varying, points)
    contradiction = ""
    if not cost.consistent:
        contradiction = "its equations have no solution"
    elif violated.any():
        contradiction = "a row without free variables is violated"
    elif not allowed.any(axis=1).all():
        name = instance.choices[int(np.argmin(allowed.any(axis=1)))].name
        contradiction = f"no alternative of {name} is possible"
    elif _impossible(balls):
        contradiction = "a ball without free variables is violated"
    form = NormalForm(
        instance=instance,
        cost=cost,
        rows=rows,
        lower=lower,
        upper=upper,
        part=part,
        choice_rows=slice(base, m),
        offset=offset,
        varying=varying,
        groups=_groups(tables, start, points, parts),
        tables=tuple(tables),
        start=start,
        points=points,
        stacked=choices,
        choice_part=parts.choice,
        allowed=allowed,
        balls=balls,
        contradiction=contradiction,
    )
    if not contradiction:
        lower[base:], upper[base:] = form.choice_bounds(form.root)
    return form


def _possible(
    tables: list[ChoiceTable],
    start: IntArray,
    offset: Array,
    varying: BoolArray,
    points: ChoicePoints,
) -> BoolArray:
    """Alternatives that are not empty and agree with the rows that do not depend on z, (C, R)."""
    widest = max((t.count for t in tables), default=1)
    allowed = np.zeros((len(tables), widest), bool)
    for c, table in enumerate(tables):
        here = slice(start[c], start[c + 1])
        off = np.maximum(offset[here] - table.own_upper, table.own_lower - offset[here])
        wrong = (off > FEASIBILITY) & ~varying[here]
        allowed[c, : table.count] = ~wrong.any(axis=1) & ~table.empty
        at = slice(points.start[c], points.start[c + 1])
        if not table.complete and np.abs(points.E[at]).max(initial=0.0) <= _CONSTANT:
            allowed[c, : table.count] &= own_violations(table, points.e[at][None])[0] <= FEASIBILITY
    return allowed


def own_violations(table: ChoiceTable, points: Array) -> Array:
    """By how much points (G, d) violate what every alternative states, (G, R)."""
    along = (points @ table.own.directions.T)[:, table.own.index]  # (G, R, q)
    off = np.maximum(along - table.own.upper, table.own.lower - along)
    return off.max(axis=-1, initial=0.0)


def _groups(
    tables: list[ChoiceTable], start: IntArray, points: ChoicePoints, parts: Components
) -> tuple[ChoiceGroup, ...]:
    members: dict[tuple[int, int], list[int]] = {}
    for c, table in enumerate(tables):
        members.setdefault((id(table), int(parts.choice[c])), []).append(c)
    groups = []
    for (_, part), choices in members.items():
        table = tables[choices[0]]
        rows = start[choices][:, None] + np.arange(len(table.directions))
        at = points.start[choices][:, None] + np.arange(table.directions.shape[1])
        groups.append(ChoiceGroup(table, np.array(choices), rows, at, part))
    return tuple(groups)


def _balls(
    instance: Instance, parts: Components, cost: ScaledCost, relief: sparse.csr_matrix | None
) -> BallForm:
    """All balls in z, those of lower dimension padded with zero rows."""
    k = cost.X.shape[1]
    d = max((b.f.shape[1] for b in instance.balls), default=1)
    F, f, part = [np.zeros((0, d, k))], [np.zeros((0, d))], [np.zeros(0, np.int64)]
    for balls in instance.balls:
        own = balls.f.shape[1]
        padded = np.zeros((balls.count, d, k))
        padded[:, :own] = np.asarray(balls.F @ cost.X).reshape(balls.count, own, k)
        offset = np.zeros((balls.count, d))
        offset[:, :own] = balls.vectors(cost.center)
        F.append(padded)
        f.append(offset)
        if balls.count:
            first = parts.of_rows(balls.F).reshape(balls.count, own)
            touched = np.asarray(abs(balls.F).sum(axis=1)).reshape(balls.count, own) > 0
            low = np.where(touched, first, parts.count).min(axis=1)
            high = np.where(touched, first, -2).max(axis=1)
            part.append(np.where((low == high), low, -1))
    radius = np.concatenate([np.zeros(0), *(b.radius for b in instance.balls)])
    offsets = np.concatenate(f)
    rows = np.concatenate(F).reshape(offsets.size, k)
    if relief is None:
        return BallForm(rows, offsets, radius, None, np.concatenate(part))
    return BallForm(
        rows,
        offsets,
        radius + relief @ cost.center,
        np.asarray(relief @ cost.X),
        np.full(len(radius), -1),
    )


def _impossible(balls: BallForm) -> bool:
    largest = np.abs(balls.F).max(axis=1, initial=0.0).reshape(balls.f.shape)
    still = largest.max(axis=1, initial=0.0) <= _CONSTANT
    if balls.relief is not None:
        still &= np.abs(balls.relief).max(axis=1, initial=0.0) <= _CONSTANT
    excess = np.linalg.norm(balls.f, axis=1) - balls.radius
    negative = balls.relief is None and (balls.radius < 0).any()
    return bool(negative or (excess[still] > FEASIBILITY).any())
