"""Joint-torque utilisation of a braced robot while any one of its legs is in the air.

For each lifted leg a linear program distributes the contact forces of the others:

    minimise    s + _SHIFT_COST * |d|_inf        over forces f_i, utilisation s, level shift d
    subject to  sum_i f_i = W                              (force balance)
                sum_i p_i x f_i - d x W = 0                (moment balance about the shifted body)
                |J_i^T f_i| <= s tau_i                     (joint torques)
                f_i in a pyramid inside the friction cone  (friction)
                n_i^T f_i >= _MIN_NORMAL_FORCE * |W|       (contact)
                |d|_inf <= max_shift                       (shift of the body)

The utilisation s is the largest fraction of a torque limit; above 1 the motors are too weak.
`compute_torque_utilisation` uses the Jacobians of the unshifted body.
`compute_shifted_utilisation` relinearises at the shifted body: sequential linear programming with
a trust region on the shift. The force planner also models compliance, commands and stability, so
its verdict takes precedence.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any, NamedTuple

import highspy
import numpy as np

from climbplan.arrays import Array
from climbplan.robots.serial_chain import SerialChain

_FACETS = 8
_MIN_NORMAL_FORCE = 0.05  # of the weight, at every toe
_MAX_PROGRAMS = 5  # sequential programs, each with the Jacobians of the last one's shift
_MAX_HALVINGS = 4  # of a shift whose toes are out of reach
_TRUST_RADIUS = 0.05  # [m] of shift to which Jacobians are trusted from the second program on
_STEP_TOLERANCE = 2e-3  # [m] of shift
_SHIFT_COST = 2.0  # [1/m] utilisation that a metre of shift has to save


@dataclass(frozen=True)
class TorqueDemand:
    """The smallest utilisation that any posture needs, and the joint that limits it."""

    utilisation: float = np.nan  # infinite: friction cones do not suffice; NaN: nothing in reach
    limb: int = 0
    joint: int = 0  # of that limb, with the largest utilisation
    torque: float = 0.0  # that this joint needs [N m]


@dataclass(frozen=True)
class BracedStance:
    """Contacts of N limbs with J joints each, and the limits within which they bear the weight."""

    toes: Array  # (N, 3) from the centre of mass [m]
    normal: Array  # (N, 3) unit, away from the surfaces
    jacobian: Array  # (N, 3, J)
    torque: Array  # (N, J) limits [N m]
    weight: float  # [N]
    friction: float  # coefficient that may be used
    max_shift: float  # [m] of the body, in x and in y

    def select(self, limbs: list[int]) -> BracedStance:
        """Return the stance on these limbs alone."""
        return replace(
            self,
            toes=self.toes[limbs],
            normal=self.normal[limbs],
            jacobian=self.jacobian[limbs],
            torque=self.torque[limbs],
        )


class _ForceDistribution(NamedTuple):
    """The solution of one linear program for n standing limbs."""

    utilisation: float
    shift_size: float  # [m]
    forces: Array  # (3 n,) in units of the weight
    shift: Array  # (2,) [m]


def find_overloaded_joint(utilisation: float, stance: BracedStance) -> TorqueDemand:
    """Find the joint that needs the given utilisation when one limb is lifted.

    Args:
        utilisation: The largest over all lifts, from `compute_torque_utilisation`.
        stance: The contacts.
    """
    demand, max_used = TorqueDemand(utilisation), 0.0
    for standing, solution in _solve_lifts(stance):
        if solution is None:
            continue
        force = stance.weight * solution.forces.reshape(-1, 3)
        needed = np.abs(np.einsum("nij,ni->nj", stance.jacobian[standing], force))
        fraction = needed / stance.torque[standing]
        limb, joint = (int(k) for k in np.unravel_index(int(np.argmax(fraction)), fraction.shape))
        if fraction[limb, joint] > max_used:
            max_used = float(fraction[limb, joint])
            torque = float(needed[limb, joint])
            demand = TorqueDemand(utilisation, standing[limb], joint, torque)
    return demand


def _solve_lifts(
    stance: BracedStance,
) -> Iterator[tuple[list[int], _ForceDistribution | None]]:
    """Yield the standing limbs and their force distribution, with each limb lifted in turn."""
    count = len(stance.toes)
    for lifted in range(count):
        standing = [i for i in range(count) if i != lifted]
        yield standing, _distribute_forces(stance.select(standing))


def compute_torque_utilisation(stance: BracedStance) -> tuple[float, float]:
    """Return the largest utilisation over all lifts and the largest shift of the body [m].

    Both are infinite where some lift has no solution. A utilisation above 1 means that the motors
    are too weak.
    """
    utilisation, shift = 0.0, 0.0
    for _, solution in _solve_lifts(stance):
        if solution is None:
            return np.inf, np.inf
        utilisation = max(utilisation, solution.utilisation)
        shift = max(shift, solution.shift_size)
    return utilisation, shift


class ShiftedUtilisation(NamedTuple):
    """The largest utilisation and shift over all lifts; infinite where a lift has no solution."""

    utilisation: float
    shift: float  # [m]
    worst_lifted: int  # limb with whose lift the utilisation is largest


def compute_shifted_utilisation(
    chain: SerialChain,
    bounds: tuple[Array, Array],
    angles: Array,
    stance: BracedStance,
    cutoff: float = np.inf,
    first_lifted: int = 0,
) -> ShiftedUtilisation:
    """Return utilisation and shift with exact kinematics of the shifted body.

    The toes stay where they are, and the centre of mass is taken to move with the body.

    Args:
        chain: The legs.
        bounds: Lower and upper joint bounds, each (N, J) [rad].
        angles: Joint angles of the unshifted body, (N, J) [rad].
        stance: The contacts; its Jacobians are those of the unshifted body.
        cutoff: Utilisation above which no further lifts are evaluated.
        first_lifted: Limb whose lift is evaluated first.
    """
    count = len(stance.toes)
    chain = replace(chain, posture=angles)
    toes = chain.joint_points(angles[None])[0, :, -1]
    utilisation, shift, worst = 0.0, 0.0, first_lifted
    for lifted in sorted(range(count), key=lambda limb: limb != first_lifted):
        standing = [i for i in range(count) if i != lifted]
        best = _solve_shifted_lift(chain, bounds, toes, stance, standing)
        if best is None:
            return ShiftedUtilisation(np.inf, np.inf, lifted)
        if best[0] > utilisation:
            utilisation, worst = best[0], lifted
        shift = max(shift, best[1])
        if utilisation > cutoff:
            break
    return ShiftedUtilisation(utilisation, shift, worst)


def _solve_shifted_lift(
    chain: SerialChain,
    bounds: tuple[Array, Array],
    toes: Array,
    stance: BracedStance,
    standing: list[int],
) -> tuple[float, float] | None:
    """Return the best utilisation and shift [m] of one lift by sequential linear programming.

    chain: with the angles of the unshifted body as its posture; toes: (N, 3) in its frame [m];
    standing: limbs on the wall. None where the program of the unshifted body is infeasible.
    """
    shift, jacobian, radius = np.zeros(2), stance.jacobian, stance.max_shift
    best: tuple[float, float] | None = None
    for _ in range(_MAX_PROGRAMS):
        linearised = replace(stance, jacobian=jacobian).select(standing)
        fixed = _distribute_forces(linearised, shift, 0.0)
        if fixed is not None and (best is None or fixed.utilisation < best[0]):
            best = fixed.utilisation, float(np.abs(shift).max())
        else:
            radius *= 0.5
        target = _distribute_forces(linearised, shift, radius)
        if target is None:
            break
        step = target.shift - shift
        for _ in range(_MAX_HALVINGS):
            solution = chain.inverse((toes - [*(shift + step), 0.0])[None], *bounds)
            if solution.valid[0][standing].all():
                break
            step = 0.5 * step
        else:
            break
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
        shift = shift + step
        jacobian = chain.jacobian(np.nan_to_num(solution.best()[0]))
        radius = min(radius, _TRUST_RADIUS)
    return best


def _distribute_forces(
    stance: BracedStance, centre: Array | None = None, radius: float = np.inf
) -> _ForceDistribution | None:
    """Solve the linear program of the module for standing limbs; None where it is infeasible.

    centre: (2,) shift [m] about which the trust region of half width `radius` [m] lies. Unknowns:
    forces in units of the weight, s, the shift in x and y, and its size.
    """
    middle = np.zeros(2) if centre is None else centre
    low = np.maximum(-stance.max_shift, middle - radius)
    high = np.minimum(stance.max_shift, middle + radius)
    n = len(stance.toes)
    size = 3 * n + 4
    equal = np.zeros((6, size))
    for i in range(n):
        x, y, z = stance.toes[i]
        equal[:3, 3 * i : 3 * i + 3] = np.eye(3)
        equal[3:, 3 * i : 3 * i + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    # Toes are at p - d from the shifted body, under the weight's reaction of one: d x (0, 0, 1)
    equal[3, -2], equal[4, -3] = -1.0, 1.0
    right = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    rows, limits = _build_inequalities(stance)
    cost = np.zeros(size)
    cost[3 * n], cost[-1] = 1.0, _SHIFT_COST
    lower = np.concatenate([np.full(3 * n, -np.inf), [0.0], low, [0.0]])
    upper = np.concatenate([np.full(3 * n + 1, np.inf), high, [stance.max_shift]])
    x = _solve_linear_program(
        cost,
        np.concatenate([rows, equal]),
        (np.concatenate([np.full(len(limits), -np.inf), right]), np.concatenate([limits, right])),
        (lower, upper),
    )
    if x is None:
        return None
    return _ForceDistribution(float(x[3 * n]), float(x[-1]), x[: 3 * n], x[3 * n + 1 : 3 * n + 3])


class _QuietLinearSolver(highspy.Highs):
    """HiGHS without the line that its constructor prints.

    `climbplan.solvers` has the same, but is above robots in the order of imports.
    """

    def enableCallbacks(self) -> None:
        """Disable output before the constructor enables callbacks."""
        self.setOptionValue("output_flag", False)
        super().enableCallbacks()  # type: ignore[no-untyped-call]


@cache
def _create_solver() -> Any:
    """Return the HiGHS solver that all of these small programs share."""
    solver: Any = _QuietLinearSolver()  # type: ignore[no-untyped-call]
    solver.setOptionValue("threads", 1)
    return solver


def _solve_linear_program(
    cost: Array, rows: Array, row_bounds: tuple[Array, Array], bounds: tuple[Array, Array]
) -> Array | None:
    """Return x (V,) that minimises cost (V,) within bounds of rows (R, V) and of x; None if none.

    The solver is called directly, as calls by SciPy take several times as long as such programs.
    """
    program = highspy.HighsLp()
    program.num_col_, program.num_row_ = rows.shape[1], rows.shape[0]
    program.col_cost_ = cost
    program.col_lower_, program.col_upper_ = bounds
    program.row_lower_, program.row_upper_ = row_bounds
    entries = rows != 0
    program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    program.a_matrix_.start_ = np.concatenate([[0], np.cumsum(entries.sum(axis=1))])
    program.a_matrix_.index_ = np.nonzero(entries)[1]
    program.a_matrix_.value_ = rows[entries]
    solver = _create_solver()
    solver.passModel(program)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return None
    return np.array(solver.getSolution().col_value)


def _build_inequalities(stance: BracedStance) -> tuple[Array, Array]:
    """Return rows and right-hand sides of friction, contact, torque and shift constraints."""
    n = len(stance.toes)
    size = 3 * n + 4
    rows: list[Array] = []
    limits: list[Array] = []
    inner = stance.friction * np.cos(np.pi / _FACETS)
    for i in range(n):
        columns, normal = slice(3 * i, 3 * i + 3), stance.normal[i]
        tangents = _build_tangents(tuple(normal.tolist()))
        pyramid = np.zeros((_FACETS, size))
        pyramid[:, columns] = tangents - inner * normal
        contact = np.zeros((1, size))
        contact[0, columns] = -normal
        torque = np.zeros((2 * stance.jacobian.shape[2], size))
        fraction = stance.weight * stance.jacobian[i].T / stance.torque[i][:, None]
        torque[:, columns] = np.concatenate([fraction, -fraction])
        torque[:, 3 * n] = -1.0
        rows += [pyramid, contact, torque]
        limits += [np.zeros(_FACETS), np.array([-_MIN_NORMAL_FORCE]), np.zeros(len(torque))]
    for column, sign in itertools.product((-3, -2), (1.0, -1.0)):
        row = np.zeros((1, size))
        row[0, column], row[0, -1] = sign, -1.0
        rows.append(row)
        limits.append(np.zeros(1))
    return np.vstack(rows), np.concatenate(limits)


@lru_cache(maxsize=64)
def _build_tangents(normal: tuple[float, ...]) -> Array:
    """Return unit vectors (_FACETS, 3) at equal angles in the plane of a unit normal."""
    angle = 2 * np.pi * np.arange(_FACETS) / _FACETS
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    return np.asarray(np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
