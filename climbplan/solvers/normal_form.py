"""An instance as the search reads it: scaled cost, all rows in z, choices as intervals of rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from climbplan.program.instance import Choice, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.bound_propagation import largest_cost, propagated_box
from climbplan.solvers.choice_table import UNBOUNDED, ChoiceTable
from climbplan.solvers.components import SAME, Components, components, equations
from climbplan.solvers.cost_scaling import ScaledCost, scaled_cost
from climbplan.solvers.result import FEASIBILITY, Indices

_CERTAIN = 1e9  # where variables are not bounded: costs are taken to stay below this multiple
_CONSTANT = 1e-9  # rows shorter than this in z do not depend on z

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class BallForm:
    """|| F_k z + f_k || <= radius_k + relief_k z."""

    F: Array  # (K d, k) rows of ball k are k d ... k d + d - 1
    f: Array  # (K, d)
    radius: Array  # (K,)
    relief: Array | None  # (K, k)
    part: Indices  # (K,) -1 where a ball couples parts

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
    choices: Indices  # (G,)
    rows: Indices  # (G, D) rows of the normal form
    part: int


@dataclass(frozen=True)
class NormalForm:
    """minimise the scaled cost over rows, balls and choices in z."""

    instance: Instance
    cost: ScaledCost
    rows: Array  # (m, k) bounds and rows of the instance, then the directions of the choices
    lower: Array  # (m,)
    upper: Array  # (m,)
    part: Indices  # (m,) -1 where a row couples parts
    choice_rows: slice
    offset: Array  # (m,) a choice's row takes the value rows z + offset in its table
    varying: Flags  # (m,) False for rows that do not depend on z
    groups: tuple[ChoiceGroup, ...]
    tables: tuple[ChoiceTable, ...]  # (C,)
    start: Indices  # (C + 1,) first row of each choice
    allowed: Flags  # (C, R) alternatives not excluded from the start
    balls: BallForm
    contradiction: str  # why no point is feasible, "" if nothing is known

    @cached_property
    def ceiling(self) -> float:
        """A bound above this proves infeasibility: no feasible point costs more."""
        cost = largest_cost(self.instance, propagated_box(self.instance, list(self.tables)))
        return cost if np.isfinite(cost) else _CERTAIN * (1.0 + abs(self.cost.constant))

    @property
    def size(self) -> int:
        """k."""
        return self.rows.shape[1]

    def x(self, z: Array) -> Array:
        """The instance's variables at z."""
        return np.asarray(self.cost.center + self.cost.X @ z)

    def choice_bounds(self, allowed: Flags) -> tuple[Array, Array]:
        """Bounds of all choice rows for sets of allowed alternatives (C, R)."""
        rows = self.choice_rows
        lower, upper = self.lower[rows].copy(), self.upper[rows].copy()
        for c, table in enumerate(self.tables):
            here = slice(self.start[c] - rows.start, self.start[c + 1] - rows.start)
            lower[here], upper[here] = self.hull(c, table.mask(allowed[c]))
        return lower, upper

    def hull(self, choice: int, mask: int) -> tuple[Array, Array]:
        """Bounds of one choice's rows for a set of alternatives."""
        here = slice(self.start[choice], self.start[choice + 1])
        low, high = self.tables[choice].hull(mask)
        varying, offset = self.varying[here], self.offset[here]
        return (
            np.where(varying & (low > -UNBOUNDED), low - offset, -UNBOUNDED),
            np.where(varying & (high < UNBOUNDED), high - offset, UNBOUNDED),
        )


def normal_form(instance: Instance, relief: sparse.csr_matrix | None = None) -> NormalForm:
    """Eliminate equations, scale the cost, and express everything in z.

    relief: (balls, n) adds relief_k x to the radius of ball k, for elastic instances.
    """
    tables = _choice_tables(instance.choices)
    equal = equations(instance, tables)
    parts = components(instance, equal)
    cost = scaled_cost(instance, parts, equal, lambda: propagated_box(instance, tables))
    balls = _balls(instance, parts, cost, relief)

    bounded = np.flatnonzero(
        (np.isfinite(instance.lower) | np.isfinite(instance.upper))
        & (instance.upper - instance.lower > SAME)
    )
    open_rows = np.flatnonzero(instance.row_upper - instance.row_lower > SAME)
    unit = sparse.identity(instance.size, format="csr")
    stacked = sparse.vstack(
        [
            unit[bounded],
            instance.A[open_rows],
            *(sparse.csr_matrix(t.directions) @ c.E for c, t in _paired(instance, tables)),
        ]
    ).tocsr()
    rows = np.asarray(stacked @ cost.X)
    base = len(bounded) + len(open_rows)
    start = base + np.cumsum([0, *(len(t.directions) for t in tables)])
    m = len(rows)
    shift = np.asarray(stacked @ cost.center)
    stated = [t.directions @ c.e for c, t in _paired(instance, tables)]
    offset = shift + np.concatenate([np.zeros(base), *stated])
    part = parts.of_rows(stacked)
    for c in range(len(tables)):
        part[start[c] : start[c + 1]] = parts.choice[c]
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

    allowed = _possible(tables, start, offset, varying)
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
        groups=_groups(tables, start, parts),
        tables=tuple(tables),
        start=start,
        allowed=allowed,
        balls=balls,
        contradiction=contradiction,
    )
    if not contradiction:
        lower[base:], upper[base:] = form.choice_bounds(allowed)
    return form


def _paired(instance: Instance, tables: list[ChoiceTable]) -> list[tuple[Choice, ChoiceTable]]:
    return list(zip(instance.choices, tables, strict=True))


def _choice_tables(choices: tuple[Choice, ...]) -> list[ChoiceTable]:
    """One table for each choice, shared between choices of the same alternatives."""
    known: dict[tuple[int, ...], ChoiceTable] = {}
    tables = []
    for choice in choices:
        key = tuple(id(p) for p in choice.alternatives)
        if key not in known:
            known[key] = ChoiceTable.of(choice.alternatives)
        tables.append(known[key])
    return tables


def _possible(tables: list[ChoiceTable], start: Indices, offset: Array, varying: Flags) -> Flags:
    """Alternatives that are not empty and agree with the rows that do not depend on z, (C, R)."""
    widest = max((t.count for t in tables), default=1)
    allowed = np.zeros((len(tables), widest), bool)
    for c, table in enumerate(tables):
        here = slice(start[c], start[c + 1])
        off = np.maximum(offset[here] - table.own_upper, table.own_lower - offset[here])
        wrong = (off > FEASIBILITY) & ~varying[here]
        allowed[c, : table.count] = ~wrong.any(axis=1) & ~table.empty
    return allowed


def _groups(
    tables: list[ChoiceTable], start: Indices, parts: Components
) -> tuple[ChoiceGroup, ...]:
    members: dict[tuple[int, int], list[int]] = {}
    for c, table in enumerate(tables):
        members.setdefault((id(table), int(parts.choice[c])), []).append(c)
    groups = []
    for (_, part), choices in members.items():
        table = tables[choices[0]]
        rows = start[choices][:, None] + np.arange(len(table.directions))
        groups.append(ChoiceGroup(table, np.array(choices), rows, part))
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
