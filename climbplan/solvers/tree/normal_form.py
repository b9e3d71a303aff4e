"""An instance in the form of the search: scaled cost, rows in z, choices as intervals of rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.box import VariableBox, propagate_box
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY
from climbplan.solvers.tree.choice_hulls import build_choice_hulls, compute_max_cost
from climbplan.solvers.tree.choice_table import UNBOUNDED, ChoiceTable, Mask, build_choice_tables
from climbplan.solvers.tree.components import SAME, Components, find_components, find_equations
from climbplan.solvers.tree.cost_scaling import ScaledCost, scale_cost
from climbplan.solvers.tree.stacked_choices import StackedChoices

_CERTAIN = 1e9  # assumed largest multiple of the cost where variables are not bounded
_CONSTANT = 1e-9  # rows shorter than this in z do not depend on z

Masks = tuple[Mask, ...]  # allowed alternatives of every choice


class OutOfTime(Exception):
    """Report that the deadline came before the form was built."""


@dataclass(frozen=True)
class BallForm:
    """Balls || F_k z + f_k || <= radius_k + relief_k z."""

    F: Array  # (K d, k) rows of ball k are k d ... k d + d - 1
    f: Array  # (K, d)
    radius: Array  # (K,)
    relief: Array | None  # (K, k)
    component: IntArray  # (K,) component, -1 where a ball couples components

    def vectors(self, z: Array) -> Array:
        """Return F z + f, (K, d)."""
        return (self.F @ z).reshape(self.f.shape) + self.f

    def radii(self, z: Array) -> Array:
        """Return the radii at z, (K,)."""
        return self.radius if self.relief is None else self.radius + self.relief @ z


@dataclass(frozen=True)
class ChoiceGroup:
    """G choices with the same alternatives, whose rows are stacked in one array."""

    table: ChoiceTable
    choices: IntArray  # (G,)
    rows: IntArray  # (G, D) rows of the normal form
    points: IntArray  # (G, d) entries of the choices' points
    component: int


@dataclass(frozen=True)
class ChoicePoints:
    """Points of all choices, one after another: E z + e."""

    E: Array  # (sum d, k)
    e: Array  # (sum d,)
    start: IntArray  # (C + 1,)


@dataclass(frozen=True)
class AlternativeRowsInZ:
    """Rows lower <= rows z <= upper of one alternative of a choice."""

    rows: Array  # (q, k)
    lower: Array  # (q,)
    upper: Array  # (q,)


@dataclass(frozen=True)
class NormalForm:
    """Minimise the scaled cost subject to rows, balls and choices in z."""

    instance: Instance
    cost: ScaledCost
    rows: Array  # (m, k) bounds and rows of the instance, then the directions of the choices
    lower: Array  # (m,)
    upper: Array  # (m,)
    component: IntArray  # (m,) component, -1 where a row couples components
    choice_rows: slice
    offset: Array  # (m,) the value of a choice's row in its table is rows z + offset
    varying: BoolArray  # (m,) False for rows that do not depend on z
    groups: tuple[ChoiceGroup, ...]
    tables: tuple[ChoiceTable, ...]  # (C,)
    start: IntArray  # (C + 1,) first row of each choice
    points: ChoicePoints
    stacked: StackedChoices
    choice_component: IntArray  # (C,) component, -1 where a choice's point does not depend on x
    allowed: BoolArray  # (C, R) alternatives not excluded from the start
    balls: BallForm
    contradiction: str  # reason why no point is feasible, "" if none is known

    @cached_property
    def max_cost(self) -> float:
        """Upper bound on the cost of feasible points, above which a bound proves infeasibility."""
        hulls = build_choice_hulls(self.instance, list(self.tables), self.stacked)
        cost = compute_max_cost(self.instance, propagate_box(self.instance, hulls))
        return cost if np.isfinite(cost) else _CERTAIN * (1.0 + abs(self.cost.constant))

    @property
    def size(self) -> int:
        """Number of coordinates k."""
        return self.rows.shape[1]

    def recover_x(self, z: Array) -> Array:
        """Return the instance's variables at z."""
        return np.asarray(self.cost.center + self.cost.X @ z)

    @property
    def root_masks(self) -> Masks:
        """Alternatives not excluded from the start, one set for each choice."""
        return self.encode_masks(self.allowed)

    def encode_masks(self, allowed: BoolArray) -> Masks:
        """Return sets of alternatives from flags (C, R)."""
        return tuple(t.encode_mask(flags) for t, flags in zip(self.tables, allowed, strict=True))

    def decode_masks(self, masks: Masks) -> BoolArray:
        """Return flags (C, R) from sets of alternatives."""
        width = (self.allowed.shape[1] + 7) // 8
        packed = np.frombuffer(b"".join(m.to_bytes(width, "little") for m in masks), np.uint8)
        bits = np.unpackbits(packed.reshape(-1, width), axis=1, bitorder="little")
        return bits[:, : self.allowed.shape[1]].view(np.bool_)

    def compute_choice_bounds(self, masks: Masks) -> tuple[Array, Array]:
        """Return bounds of all choice rows for sets of allowed alternatives."""
        return self._shift_to_z(
            [t.compute_hull(m) for t, m in zip(self.tables, masks, strict=True)]
        )

    def compute_bounds_of(self, choices: IntArray, masks: Masks) -> tuple[Array, Array]:
        """Return bounds of the rows of some choices, one after another, for one set each."""
        hulls = [self.tables[c].compute_hull(m) for c, m in zip(choices, masks, strict=True)]
        return self._shift_to_z(hulls, self.list_rows_of(choices))

    def list_rows_of(self, choices: IntArray) -> IntArray:
        """Return the rows of some choices, one after another."""
        ranges = [np.arange(self.start[c], self.start[c + 1]) for c in choices]
        return np.concatenate([np.zeros(0, np.int64), *ranges])

    def _shift_to_z(
        self, hulls: list[tuple[Array, Array]], rows: IntArray | slice | None = None
    ) -> tuple[Array, Array]:
        """Convert intervals of the tables to z; rows that do not depend on z get none."""
        rows = self.choice_rows if rows is None else rows
        low = np.concatenate([np.zeros(0), *(h[0] for h in hulls)])
        high = np.concatenate([np.zeros(0), *(h[1] for h in hulls)])
        varying, offset = self.varying[rows], self.offset[rows]
        return (
            np.where(varying & (low > -UNBOUNDED), low - offset, -UNBOUNDED),
            np.where(varying & (high < UNBOUNDED), high - offset, UNBOUNDED),
        )

    def build_alternative_rows(self, choice: int, alternative: int) -> AlternativeRowsInZ:
        """Return the exact rows of one alternative, for tables that are not complete."""
        exact = self.tables[choice].exact
        is_stated = (exact.lower[alternative] > -UNBOUNDED) | (exact.upper[alternative] < UNBOUNDED)
        directions = exact.directions[exact.index[alternative, is_stated]]
        points = slice(self.points.start[choice], self.points.start[choice + 1])
        rows = directions @ self.points.E[points]
        offset = directions @ self.points.e[points]
        lower, upper = exact.lower[alternative, is_stated], exact.upper[alternative, is_stated]
        low = np.where(lower > -UNBOUNDED, lower - offset, -UNBOUNDED)
        high = np.where(upper < UNBOUNDED, upper - offset, UNBOUNDED)
        is_constant = np.linalg.norm(rows, axis=1) <= _CONSTANT
        is_satisfied = is_constant & (low <= FEASIBILITY) & (high >= -FEASIBILITY)
        rows[is_constant] = 0.0
        low[is_satisfied], high[is_satisfied] = -UNBOUNDED, UNBOUNDED
        return AlternativeRowsInZ(rows, low, high)


def build_normal_form(
    instance: Instance,
    relief: sparse.csr_matrix | None = None,
    late: Callable[[], bool] = lambda: False,
) -> NormalForm:
    """Eliminate equations, scale the cost, and express everything in z.

    Args:
        instance: Instance without integers and products.
        relief: (balls, n) matrix of an elastic instance; relief x is added to the balls' radii.
        late: Function, called between steps, that returns whether the deadline has passed.

    Raises:
        OutOfTime: `late` returned True.
    """

    def check_time() -> None:
        if late():
            raise OutOfTime

    def compute_box() -> VariableBox:
        return propagate_box(instance, build_choice_hulls(instance, tables, choices))

    tables = build_choice_tables(instance.choices)
    check_time()
    choices = StackedChoices.stack(instance.choices, tables, instance.size)
    equations = find_equations(instance, tables, choices)
    components = find_components(instance, equations, choices)
    check_time()
    cost = scale_cost(instance, components, equations, compute_box)
    check_time()
    balls = _build_balls(instance, components, cost, relief)
    check_time()
    rows = _express_in_z(_select_inequalities(instance), choices, components, cost)
    points = _express_points_in_z(instance, choices, cost)
    allowed = _find_possible(tables, rows, points)
    contradiction = _explain_contradiction(instance, cost, rows.is_violated, allowed, balls)
    form = NormalForm(
        instance=instance,
        cost=cost,
        rows=rows.rows,
        lower=rows.lower,
        upper=rows.upper,
        component=rows.component,
        choice_rows=rows.choice_rows,
        offset=rows.offset,
        varying=rows.varying,
        groups=_group_choices(tables, rows.start, points, components),
        tables=tuple(tables),
        start=rows.start,
        points=points,
        stacked=choices,
        choice_component=components.choice,
        allowed=allowed,
        balls=balls,
        contradiction=contradiction,
    )
    if not contradiction:
        lower, upper = form.compute_choice_bounds(form.root_masks)
        form.lower[form.choice_rows], form.upper[form.choice_rows] = lower, upper
    return form


@dataclass(frozen=True)
class _Inequalities:
    """Rows lower <= rows x <= upper that are not equations."""

    rows: sparse.csr_matrix  # (m, n)
    lower: Array  # (m,)
    upper: Array  # (m,)


def _select_inequalities(instance: Instance) -> _Inequalities:
    """Select the bounds of variables and the rows of an instance that are not equations."""
    bounded = np.flatnonzero(
        (np.isfinite(instance.lower) | np.isfinite(instance.upper))
        & (instance.upper - instance.lower > SAME)
    )
    open_rows = np.flatnonzero(instance.row_upper - instance.row_lower > SAME)
    unit = sparse.identity(instance.size, format="csr")
    return _Inequalities(
        sparse.vstack([unit[bounded], instance.A[open_rows]]).tocsr(),
        np.concatenate([instance.lower[bounded], instance.row_lower[open_rows]]),
        np.concatenate([instance.upper[bounded], instance.row_upper[open_rows]]),
    )


@dataclass(frozen=True)
class _RowsInZ:
    """Inequalities, then the directions of choices, over z; the latter have no bounds yet."""

    rows: Array  # (m, k)
    lower: Array  # (m,)
    upper: Array  # (m,)
    component: IntArray  # (m,) component, -1 where a row couples components
    choice_rows: slice
    start: IntArray  # (C + 1,) first row of each choice
    offset: Array  # (m,) the value of a row is rows z + offset
    varying: BoolArray  # (m,) False for rows that do not depend on z
    is_violated: bool  # whether an inequality that does not depend on z is violated


def _express_in_z(
    stated: _Inequalities, choices: StackedChoices, components: Components, cost: ScaledCost
) -> _RowsInZ:
    """Express inequalities and directions of choices in z."""
    stacked = sparse.vstack([stated.rows, choices.rows]).tocsr()
    rows = np.asarray(stacked @ cost.X)
    base, m = len(stated.lower), len(rows)
    shift = np.asarray(stacked @ cost.center)
    offset = shift + np.concatenate([np.zeros(base), choices.offset])
    varying = np.linalg.norm(rows, axis=1) > _CONSTANT
    rows[~varying] = 0.0
    lower, upper = np.full(m, -UNBOUNDED), np.full(m, UNBOUNDED)
    lower[:base] = np.maximum(stated.lower - offset[:base], -UNBOUNDED)
    upper[:base] = np.minimum(stated.upper - offset[:base], UNBOUNDED)
    is_constant = np.flatnonzero(~varying[:base])
    violated = (lower[is_constant] > FEASIBILITY) | (upper[is_constant] < -FEASIBILITY)
    lower[is_constant], upper[is_constant] = -UNBOUNDED, UNBOUNDED
    component = components.locate_rows(stacked)
    component[base:] = np.repeat(components.choice, np.diff(choices.start))
    return _RowsInZ(
        rows=rows,
        lower=lower,
        upper=upper,
        component=component,
        choice_rows=slice(base, m),
        start=base + choices.start,
        offset=offset,
        varying=varying,
        is_violated=bool(violated.any()),
    )


def _express_points_in_z(
    instance: Instance, choices: StackedChoices, cost: ScaledCost
) -> ChoicePoints:
    """Express the points of all choices in z."""
    return ChoicePoints(
        np.asarray(choices.E @ cost.X),
        np.asarray(choices.E @ cost.center) + choices.e,
        np.concatenate([[0], np.cumsum([len(c.e) for c in instance.choices])]).astype(np.int64),
    )


def _explain_contradiction(
    instance: Instance,
    cost: ScaledCost,
    has_violated_row: bool,
    allowed: BoolArray,
    balls: BallForm,
) -> str:
    """Return why no point is feasible, empty if no reason is known."""
    if not cost.consistent:
        return "its equations have no solution"
    if has_violated_row:
        return "a row without free variables is violated"
    if not allowed.any(axis=1).all():
        name = instance.choices[int(np.argmin(allowed.any(axis=1)))].name
        return f"no alternative of {name} is possible"
    return "a ball without free variables is violated" if _is_infeasible(balls) else ""


def _find_possible(tables: list[ChoiceTable], rows: _RowsInZ, points: ChoicePoints) -> BoolArray:
    """Return (C, R) mask of alternatives that satisfy all rows that do not depend on z."""
    max_alternatives = max((t.count for t in tables), default=1)
    allowed = np.zeros((len(tables), max_alternatives), bool)
    for c, table in enumerate(tables):
        span = slice(rows.start[c], rows.start[c + 1])
        value = rows.offset[span]
        violation = np.maximum(value - table.exact_upper, table.exact_lower - value)
        is_violated = (violation > FEASIBILITY) & ~rows.varying[span]
        allowed[c, : table.count] = ~is_violated.any(axis=1) & ~table.is_empty
        point = slice(points.start[c], points.start[c + 1])
        if not table.is_complete and np.abs(points.E[point]).max(initial=0.0) <= _CONSTANT:
            allowed[c, : table.count] &= (
                compute_exact_violations(table, points.e[point][None])[0] <= FEASIBILITY
            )
    return allowed


def compute_exact_violations(table: ChoiceTable, points: Array) -> Array:
    """Return the violation (G, R) of every alternative's stated rows by points (G, d)."""
    values = (points @ table.exact.directions.T)[:, table.exact.index]  # (G, R, q)
    violation = np.maximum(values - table.exact.upper, table.exact.lower - values)
    return violation.max(axis=-1, initial=0.0)


def _group_choices(
    tables: list[ChoiceTable], start: IntArray, points: ChoicePoints, components: Components
) -> tuple[ChoiceGroup, ...]:
    """Group choices with the same table and component."""
    members: dict[tuple[int, int], list[int]] = {}
    for c, table in enumerate(tables):
        members.setdefault((id(table), int(components.choice[c])), []).append(c)
    groups = []
    for (_, component), choices in members.items():
        table = tables[choices[0]]
        rows = start[choices][:, None] + np.arange(len(table.directions))
        point_entries = points.start[choices][:, None] + np.arange(table.directions.shape[1])
        groups.append(ChoiceGroup(table, np.array(choices), rows, point_entries, component))
    return tuple(groups)


def _build_balls(
    instance: Instance, components: Components, cost: ScaledCost, relief: sparse.csr_matrix | None
) -> BallForm:
    """Build all balls in z; those of lower dimension are padded with zero rows."""
    k = cost.X.shape[1]
    d = max((b.f.shape[1] for b in instance.balls), default=1)
    F, f, component = [np.zeros((0, d, k))], [np.zeros((0, d))], [np.zeros(0, np.int64)]
    for balls in instance.balls:
        dimension = balls.f.shape[1]
        padded = np.zeros((balls.count, d, k))
        padded[:, :dimension] = np.asarray(balls.F @ cost.X).reshape(balls.count, dimension, k)
        offset = np.zeros((balls.count, d))
        offset[:, :dimension] = balls.vectors(cost.center)
        F.append(padded)
        f.append(offset)
        if balls.count:
            component_of_row = components.locate_rows(balls.F).reshape(balls.count, dimension)
            has_entries = np.asarray(abs(balls.F).sum(axis=1)).reshape(balls.count, dimension) > 0
            low = np.where(has_entries, component_of_row, components.count).min(axis=1)
            high = np.where(has_entries, component_of_row, -2).max(axis=1)
            component.append(np.where((low == high), low, -1))
    radius = np.concatenate([np.zeros(0), *(b.radius for b in instance.balls)])
    offsets = np.concatenate(f)
    rows = np.concatenate(F).reshape(offsets.size, k)
    if relief is None:
        return BallForm(rows, offsets, radius, None, np.concatenate(component))
    return BallForm(
        rows,
        offsets,
        radius + relief @ cost.center,
        np.asarray(relief @ cost.X),
        np.full(len(radius), -1),
    )


def _is_infeasible(balls: BallForm) -> bool:
    """Return whether a ball without free variables is violated."""
    largest = np.abs(balls.F).max(axis=1, initial=0.0).reshape(balls.f.shape)
    is_constant = largest.max(axis=1, initial=0.0) <= _CONSTANT
    if balls.relief is not None:
        is_constant &= np.abs(balls.relief).max(axis=1, initial=0.0) <= _CONSTANT
    excess = np.linalg.norm(balls.f, axis=1) - balls.radius
    negative = balls.relief is None and (balls.radius < 0).any()
    return bool(negative or (excess[is_constant] > FEASIBILITY).any())
