"""Stating a program: variables, parameters, named blocks, cost terms.

Expressions are CasADi scalars in NumPy object arrays, so that a statement reads like its
derivation. Compiling extracts the coefficient matrices once as functions of the parameters;
`at(theta)` only updates numbers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from climbplan.arrays import Array, IntArray
from climbplan.deprecation import RenamedAttribute
from climbplan.program.affine_array import AffineArray, Quadratic
from climbplan.program.blocks import (
    BallBlock,
    Blocks,
    ChoiceBlock,
    ImplicationBlock,
    RowBlock,
    SmoothBlock,
    Variable,
)
from climbplan.program.compilation import CompiledProgram, compile_program
from climbplan.program.instance import Instance
from climbplan.program.polytope import Polytope
from climbplan.program.residuals import CheckReport, check_blocks
from climbplan.program.scalar import entries_of, scalars


def bounds_of(
    owner: str, lower: ArrayLike, upper: ArrayLike, shape: tuple[int, ...]
) -> tuple[Array, Array]:
    """Return lower and upper bounds as arrays of a shape.

    Args:
        owner: Whose bounds they are, as messages name it.
        lower: Numbers that broadcast to `shape`; -inf for no bound.
        upper: Numbers that broadcast to `shape`; inf for no bound.
        shape: The shape of the expression that is bounded.

    Raises:
        ValueError: If they do not fit, a lower bound is above its upper one, or one is NaN.
    """
    low = broadcast(f"{owner}: lower", np.asarray(lower, float), shape)
    high = broadcast(f"{owner}: upper", np.asarray(upper, float), shape)
    wrong = np.argwhere(~(low <= high))
    if len(wrong):
        index = tuple(int(i) for i in wrong[0])
        place = f" at {list(index)}" if index else ""
        raise ValueError(
            f"{owner}: lower <= upper expected, got lower {low[index]:g} and upper "
            f"{high[index]:g}{place}"
        )
    return low, high


def broadcast(owner: str, values: Any, shape: tuple[int, ...]) -> Any:
    """Return an array broadcast to a shape; raises ValueError with both shapes if it cannot be."""
    try:
        return np.broadcast_to(values, shape)
    except ValueError as error:
        raise ValueError(
            f"{owner}: shape {shape} expected, or one that broadcasts to it, got {values.shape}"
        ) from error


Expression = NDArray[np.object_]  # CasADi scalars, any shape


@dataclass
class Program:
    """minimise f(x; theta) subject to named blocks.

    Linear and bilinear rows, implications, balls, one-of-several-polytopes, and smooth functions.
    """

    name: str
    variables: dict[str, Variable] = field(default_factory=dict)
    parameters: dict[str, tuple[int, ...]] = field(default_factory=dict)
    _x: list[Any] = field(default_factory=list, repr=False)
    _theta: list[Any] = field(default_factory=list, repr=False)
    _rows: list[RowBlock] = field(default_factory=list, repr=False)
    _balls: list[BallBlock] = field(default_factory=list, repr=False)
    _choices: list[ChoiceBlock] = field(default_factory=list, repr=False)
    _implications: list[ImplicationBlock] = field(default_factory=list, repr=False)
    _smooth: list[SmoothBlock] = field(default_factory=list, repr=False)
    _costs: dict[str, Any] = field(default_factory=dict, repr=False)
    _compiled: CompiledProgram | None = field(default=None, repr=False)

    @classmethod
    def from_cvxpy(cls, problem: Any) -> Program:
        """State a convex `cvxpy.Problem`, with its variables under their names in CVXPY.

        Parameters of CVXPY count with their values now. Arrays are flattened column by column.
        `rows`, `cones<k>` and `balls<k>` are the blocks of constraints; variables of CVXPY's
        reductions, such as epigraphs, are named `reduction<column>`.

        Raises:
            UsageError: The problem needs more than second-order cones, is not convex, or has
                integer variables without bounds.
        """
        from climbplan.program.cvxpy_form import state_cvxpy_problem

        program = cls("cvxpy")
        state_cvxpy_problem(program, problem)
        return program

    @classmethod
    def from_casadi(cls, nlp: Mapping[str, Any], **bounds: Any) -> Program:
        """State a nonlinear program as `casadi.nlpsol` takes it.

        Args:
            nlp: CasADi symbols and expressions "x" (n,), "f", and optionally "g" (m,) and
                parameters "p".
            bounds: Optional `lbx`, `ubx` (n,), `lbg`, `ubg` (m,) and `discrete` (n,) bool.

        Raises:
            UsageError: The sizes do not fit, or an integer variable has no bounds.
        """
        from climbplan.program.casadi_form import state_casadi_problem

        program = cls("casadi")
        state_casadi_problem(program, nlp, **bounds)
        return program

    # ---- variables and parameters

    def continuous(
        self,
        name: str,
        shape: tuple[int, ...],
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
    ) -> Expression:
        """A block of continuous variables with bounds, as an array of scalars."""
        self._check_new(name, self.variables)
        low, high = bounds_of(f"{self.name}: variable {name!r}", lower, upper, shape)
        self.variables[name] = Variable(name, shape, len(self._x), low, high, unit)
        return self._symbols(name, shape, self._x)

    def __repr__(self) -> str:
        groups = (self._rows, self._balls, self._choices, self._implications, self._smooth)
        names = dict.fromkeys(block.name for group in groups for block in group)
        listed = self._list_variables()
        return f"<Program {self.name!r}: variables {listed}; blocks {', '.join(names)}>"

    def _list_variables(self) -> str:
        """Return the names of variables."""
        return ", ".join(self.variables)

    def affine(self, name: str) -> AffineArray:
        """A stated block of variables as an array whose coefficients are numbers.

        For blocks and costs without parameters and products, which it states much faster. All
        variables of a program have to be stated before the first one is asked for like this. Raises
        KeyError for a name that is not stated.
        """
        if name not in self.variables:
            raise KeyError(
                f"{self.name} states no {name!r}, its variables are {self._list_variables()}"
            )
        variable = self.variables[name]
        return AffineArray.variables(variable.start, variable.shape, len(self._x))

    def binary(self, name: str, shape: tuple[int, ...]) -> Expression:
        """A block of variables that are 0 or 1, as an array of scalars."""
        self._check_new(name, self.variables)
        low, high = np.zeros(shape), np.ones(shape)
        self.variables[name] = Variable(name, shape, len(self._x), low, high, "", integer=True)
        return self._symbols(name, shape, self._x)

    def integer(
        self, name: str, shape: tuple[int, ...], lower: ArrayLike, upper: ArrayLike, unit: str = ""
    ) -> Expression:
        """A block of integer variables with finite bounds, as an array of scalars.

        Raises:
            ValueError: A bound is infinite.
        """
        self._check_new(name, self.variables)
        low, high = bounds_of(f"{self.name}: variable {name!r}", lower, upper, shape)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError(f"{self.name}: variable {name!r}: finite bounds expected of integers")
        self.variables[name] = Variable(name, shape, len(self._x), low, high, unit, integer=True)
        return self._symbols(name, shape, self._x)

    def parameter(self, name: str, shape: tuple[int, ...]) -> Expression:
        """A block of parameters theta, as an array of scalars."""
        self._check_new(name, self.parameters)
        self.parameters[name] = shape
        return self._symbols(name, shape, self._theta)

    # ---- constraints

    def between(
        self,
        name: str,
        expression: Expression | AffineArray,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
    ) -> None:
        """lower <= expression <= upper, elementwise; the bounds are numbers.

        Expressions are affine in the variables or hold products of two of them.
        """
        entries = self._entries(name, expression)
        shape = entries.shape
        low, high = bounds_of(f"{self.name}: block {name!r}", lower, upper, shape)
        self._rows.append(RowBlock(name, shape, _flatten(entries), low.ravel(), high.ravel(), unit))
        self._compiled = None

    def equal(self, name: str, expression: Expression, unit: str = "") -> None:
        """expression == 0, elementwise."""
        self.between(name, expression, 0.0, 0.0, unit)

    def exactly_one(self, name: str, binaries: Expression) -> None:
        """One of the binaries along the last axis is 1."""
        self.between(name, np.sum(binaries, axis=-1), 1.0, 1.0)

    def when(
        self,
        name: str,
        binary: Any,
        expression: Expression,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        unit: str = "",
        *,
        value: bool = True,
    ) -> None:
        """binary == value implies lower <= expression <= upper, elementwise.

        binary: one stated binary, or one for each entry (broadcast against the expression).
        """
        entries = self._entries(name, expression)
        shape = entries.shape
        condition = broadcast(
            f"{self.name}: block {name!r}: binary", self._entries(name, binary), shape
        )
        low, high = bounds_of(f"{self.name}: block {name!r}", lower, upper, shape)
        block = ImplicationBlock(
            name,
            shape,
            list(entries.ravel()),
            low.ravel(),
            high.ravel(),
            list(condition.ravel()),
            value,
            unit,
        )
        self._implications.append(block)
        self._compiled = None

    def smooth(
        self,
        name: str,
        expression: Expression,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = 0.0,
        unit: str = "",
    ) -> None:
        """lower <= expression <= upper, elementwise, where the expression is any smooth function.

        For what is neither affine nor a product: rotations, kinematics, distances. A function that
        is the same at every knot is mapped by `climbplan.program.smooth.over_knots`. The bounds are
        numbers. nlp, mpcc, pinned and minlp-bonmin hold such blocks; mccormick, admm and reduce
        find integers without them and pin these; minlp-scip refuses them.
        """
        entries = self._entries(name, expression)
        low, high = bounds_of(f"{self.name}: block {name!r}", lower, upper, entries.shape)
        listed = list(entries.ravel())
        block = SmoothBlock(name, entries.shape, listed, low.ravel(), high.ravel(), unit)
        self._smooth.append(block)
        self._compiled = None

    def ball(
        self, name: str, vectors: Expression | AffineArray, radius: ArrayLike, unit: str = ""
    ) -> None:
        """|| vectors[k] ||_2 <= radius[k] along the last axis: a second-order cone each."""
        entries = self._entries(name, vectors)
        *shape, dimension = entries.shape
        numbers = np.asarray(radius, float)
        radii = broadcast(f"{self.name}: block {name!r}: radius", numbers, tuple(shape)).ravel()
        block = BallBlock(name, tuple(shape), _flatten(entries), dimension, radii, unit)
        self._balls.append(block)
        self._compiled = None

    def cone(
        self,
        name: str,
        vectors: Expression | AffineArray,
        limits: Expression | AffineArray,
        unit: str = "",
    ) -> None:
        """|| vectors[k] ||_2 <= limits[k] along the last axis: general second-order cones.

        Args:
            name: Name of the block.
            vectors: (..., d) affine in the variables.
            limits: (...) affine in the variables.
            unit: Unit of both.

        Raises:
            ValueError: The shapes do not fit.
        """
        entries, bounds = self._entries(name, vectors), self._entries(name, limits)
        *shape, dimension = entries.shape
        if bounds.shape != tuple(shape):
            raise ValueError(
                f"{self.name}: block {name!r}: limits of shape {tuple(shape)} expected, one for "
                f"each vector, got {bounds.shape}"
            )
        block = BallBlock(
            name,
            tuple(shape),
            _flatten(entries),
            dimension,
            np.zeros(math.prod(shape)),
            unit,
            _flatten(bounds),
        )
        self._balls.append(block)
        self._compiled = None

    def one_of(
        self,
        name: str,
        points: Expression | AffineArray,
        alternatives: Sequence[Sequence[Polytope]],
        unit: str = "",
    ) -> None:
        """points[k] (last axis) lies in one of alternatives[k]: one binary an alternative."""
        entries = self._entries(name, points)
        *shape, dimension = entries.shape
        block = ChoiceBlock(
            name,
            tuple(shape),
            _flatten(entries),
            dimension,
            tuple(tuple(group) for group in alternatives),
            unit,
        )
        if len(block.alternatives) != math.prod(shape):
            raise ValueError(f"{name}: one list of alternatives for each point is needed")
        self._choices.append(block)
        self._compiled = None

    def minimise(self, name: str, term: Any) -> None:
        """Add a named cost term (quadratic in the variables).

        Raises ValueError if the term is not one scalar.
        """
        self._check_new(name, self._costs)
        if not isinstance(term, Quadratic):
            entries = self._entries(name, term)
            if isinstance(entries, AffineArray) or entries.shape not in ((), (1,)):
                raise ValueError(
                    f"{self.name}: cost {name!r}: one scalar expected, got an array of shape "
                    f"{entries.shape}; sum its entries (np.sum), or their squares"
                )
            term = entries.item()
        self._costs[name] = term
        self._compiled = None

    # ---- instances

    def instantiate(self, theta: Mapping[str, ArrayLike] | None = None) -> Instance:
        """Return the instance at parameter values; later calls only rebuild coefficients."""
        return self._compile().instance(self.theta(theta))

    at = RenamedAttribute("instantiate")

    def theta(self, values: Mapping[str, ArrayLike] | None = None) -> Array:
        """Parameter values as one vector; raises ValueError for missing, unknown or misshapen."""
        blocks = dict(values or {})
        if set(blocks) != set(self.parameters):
            raise ValueError(f"parameters {sorted(self.parameters)} expected, got {sorted(blocks)}")
        arrays = []
        for name, shape in self.parameters.items():
            array = np.asarray(blocks[name], float)
            if array.shape != shape:
                raise ValueError(f"parameter {name}: shape {shape} expected, got {array.shape}")
            arrays.append(array.ravel())
        return np.concatenate(arrays) if arrays else np.zeros(0)

    def value(self, name: str, x: Array) -> Array:
        """The values of one variable block in a solution vector."""
        variable = self.variables[name]
        return np.asarray(x[variable.start : variable.stop]).reshape(variable.shape)

    def point(self, values: Mapping[str, ArrayLike]) -> Array:
        """The solution vector made of values of all variable blocks."""
        x = np.empty(len(self._x))
        for name, variable in self.variables.items():
            x[variable.start : variable.stop] = np.asarray(values[name], float).ravel()
        return x

    # ---- counting and checking

    @property
    def blocks(self) -> Blocks:
        """All blocks, in the order in which they were stated."""
        return Blocks(
            tuple(self.variables.values()),
            tuple(self._rows),
            tuple(self._balls),
            tuple(self._choices),
            tuple(self._implications),
            tuple(self._smooth),
        )

    def counts(self) -> dict[str, Any]:
        """Sizes in all and by block name."""
        binaries = _count_entries((b.name, sum(map(len, b.alternatives))) for b in self._choices)
        rows = _count_entries((b.name, len(b.expression)) for b in self._rows)
        balls = _count_entries((b.name, len(b.radius)) for b in self._balls)
        implied = _count_entries((b.name, len(b.expression)) for b in self._implications)
        smooth = _count_entries((b.name, len(b.expression)) for b in self._smooth)
        stated = sum(v.lower.size for v in self.variables.values() if v.integer)
        return {
            "continuous": len(self._x) - stated,
            "binary": stated + sum(binaries.values()),
            "linear_rows": sum(rows.values()),
            "balls": sum(balls.values()),
            "choices": sum(len(b.alternatives) for b in self._choices),
            "implications": sum(implied.values()),
            "products": self._compile().product_count,
            "smooth_rows": sum(smooth.values()),
            "by_block": dict(rows + balls + implied + binaries + smooth),
        }

    def check(
        self,
        x: Array,
        theta: Mapping[str, ArrayLike] | None = None,
        assignment: IntArray | None = None,
    ) -> CheckReport:
        """Residual of every named block at x.

        assignment: chosen alternative of each choice in order of statement; the least violated one
        if left out.
        """
        return check_blocks(self.blocks, self.instantiate(theta), x, assignment)

    # ---- internals

    def _compile(self) -> CompiledProgram:
        """Compile the program once."""
        if self._compiled is None:
            numeric = [c for c in self._costs.values() if isinstance(c, Quadratic)]
            stated = [c for c in self._costs.values() if not isinstance(c, Quadratic)]
            cost = sum(stated, ca.SX(0))
            self._compiled = compile_program(
                self.name, self.blocks, cost, numeric, self._x, self._theta
            )
        return self._compiled

    def _entries(self, name: str, expression: Any) -> Any:
        """An array of scalars; one scalar becomes an array of no dimensions."""
        if isinstance(expression, AffineArray):
            return expression
        return entries_of(f"{self.name}: {name!r}", expression)

    def _check_new(self, name: str, existing: Mapping[str, Any]) -> None:
        """Raise ValueError for a name that is used already, and discard the compiled program."""
        if name in existing:
            raise ValueError(f"{self.name}: {name!r} is stated twice")
        self._compiled = None

    @staticmethod
    def _symbols(name: str, shape: tuple[int, ...], target: list[Any]) -> Expression:
        """Create symbols of a block and append them."""
        block = scalars(ca.SX.sym(name, math.prod(shape)).elements())
        target.extend(block)
        return block.reshape(shape)


def _flatten(entries: Any) -> Any:
    """Return all entries in one row."""
    return entries.ravel() if isinstance(entries, AffineArray) else list(entries.ravel())


def _count_entries(blocks: Iterable[tuple[str, int]]) -> Counter[str]:
    """Sum sizes by name."""
    sizes: Counter[str] = Counter()
    for name, size in blocks:
        sizes[name] += size
    return sizes
