"""Coordinates z in which all equations hold and the cost is 1/2 |z|^2.

x = center + X z, component by component. The equations of a component are eliminated by an
orthonormal basis N of their null space (Nocedal and Wright, section 15.3). With the Cholesky factor
N'PN = L L' the cost becomes 1/2 |z|^2 + constant for z = L'w + L^-1 g.

Directions without curvature keep coordinates of their own, `flat`, in which the cost is slope z.
They are scaled so that a proximal term 1/2 |z - c|^2 is small against the cost, and confined to |z|
<= extent by the box around the feasible set, which makes the dual function finite.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from climbplan.arrays import Array, IntArray
from climbplan.program.box import VariableBox
from climbplan.program.instance import Instance
from climbplan.solvers.result import FEASIBILITY
from climbplan.solvers.tree.components import Components, Equations

_FLAT = 1e-9  # eigenvalues below this fraction of the largest count as zero
_PROXIMAL = 1e-4  # curvature of the proximal term, relative to the largest of the cost
_RANK = 1e-9


@dataclass(frozen=True)
class ScaledCost:
    """Map x = center + X z; cost 1/2 |z_i|^2 + slope_j z_j + constant over curved i and flat j."""

    X: Array  # (n, k)
    center: Array  # (n,)
    constant: float
    component: IntArray  # (k,) component of each coordinate, ascending
    flat: IntArray  # coordinates without curvature
    slope: Array  # (k,) zero where the cost is curved
    extent: Array  # (k,) |z| <= extent for flat coordinates, zero elsewhere
    consistent: bool  # whether the equations have a solution


@dataclass(frozen=True)
class _ScaledComponent:
    """Scaled coordinates of one component."""

    X: Array
    center: Array
    constant: float
    slope: Array
    extent: Array


def scale_cost(
    instance: Instance, components: Components, equal: Equations, box: Callable[[], VariableBox]
) -> ScaledCost:
    """Eliminate equations and scale the cost.

    `box` is computed only if the cost is flat in some direction.
    """
    P, E = instance.P.toarray(), equal.E.toarray()
    top = float(np.abs(P).max(initial=0.0)) or 1.0
    equation_part = components.locate_rows(equal.E)
    order = np.argsort(components.variable, kind="stable")
    members = np.split(
        order, np.cumsum(np.bincount(components.variable, minlength=components.count))[:-1]
    )
    # Equations without variables only have to be true.
    consistent = not (np.abs(equal.e[~E.any(axis=1)]) > FEASIBILITY).any()
    blocks: list[_ScaledComponent] = []
    for label, index in enumerate(members):
        selected = np.flatnonzero(equation_part == label)
        start, basis = _solve_equations(E[np.ix_(selected, index)], equal.e[selected])
        if start is None:
            consistent, start = False, np.zeros(len(index))
        blocks.append(
            _scale_component(
                P[np.ix_(index, index)],
                instance.q[index],
                start,
                basis,
                index=index,
                top=top,
                box=box,
            )
        )
    sizes = [block.X.shape[1] for block in blocks]
    X, center = np.zeros((instance.size, sum(sizes))), np.zeros(instance.size)
    for index, block, end in zip(members, blocks, np.cumsum(sizes), strict=True):
        X[index, end - block.X.shape[1] : end] = block.X
        center[index] = block.center
    extent = np.concatenate([np.zeros(0), *(block.extent for block in blocks)])
    return ScaledCost(
        X=X,
        center=center,
        constant=instance.constant + sum(block.constant for block in blocks),
        component=np.repeat(np.arange(len(blocks)), sizes),
        flat=np.flatnonzero(extent),
        slope=np.concatenate([np.zeros(0), *(block.slope for block in blocks)]),
        extent=extent,
        consistent=consistent,
    )


def _solve_equations(E: Array, e: Array) -> tuple[Array | None, Array]:
    """Return a solution of E x = e and an orthonormal basis of the null space.

    The solution is None where the equations contradict each other.
    """
    n = E.shape[1]
    if not len(E):
        return np.zeros(n), np.eye(n)
    Q, R, order = la.qr(E.T, pivoting=True)
    rank = int((np.abs(np.diag(R)) > _RANK * max(1.0, float(np.abs(R).max(initial=0.0)))).sum())
    independent = order[:rank]
    start = Q[:, :rank] @ la.solve_triangular(R[:rank, :rank], e[independent], trans="T")
    if np.abs(E @ start - e).max() > FEASIBILITY:
        return None, Q[:, rank:]
    return start, Q[:, rank:]


def _scale_component(
    P: Array,
    q: Array,
    start: Array,
    basis: Array,
    *,
    index: IntArray,
    top: float,
    box: Callable[[], VariableBox],
) -> _ScaledComponent:
    """Scale the coordinates of x = start + basis w of one component.

    Args:
        P: (v, v) Hessian of the cost over the component's variables.
        q: (v,) slope of the cost.
        start: (v,) solution of the component's equations.
        basis: (v, k) orthonormal basis of their null space.
        index: (v,) the component's variables.
        top: Largest entry of the whole Hessian, to which curvatures are compared.
        box: Function that returns the box of all variables; called if a direction is flat.
    """
    H, g = basis.T @ P @ basis, basis.T @ (P @ start + q)
    constant = float(0.5 * start @ P @ start + q @ start)
    curvature, vectors = np.linalg.eigh(H)
    curved = curvature > _FLAT * top
    if curved.all():
        L = np.linalg.cholesky(H)
        shift = la.solve_triangular(L, g, lower=True)
        X = la.solve_triangular(L, basis.T, lower=True).T
        no_slope = np.zeros(len(H))
        return _ScaledComponent(
            X, start - X @ shift, constant - float(0.5 * shift @ shift), no_slope, no_slope
        )

    steep = vectors[:, curved] / np.sqrt(curvature[curved])  # (k, curved)
    shift = steep.T @ g
    flat = vectors[:, ~curved]
    flat_rows = flat.T @ basis.T  # (flat, variables)
    limits = box()
    box_center, half = limits.middle[index], limits.half[index]
    with np.errstate(invalid="ignore"):
        reach = np.nan_to_num(np.abs(flat_rows) * half, nan=0.0, posinf=np.inf).sum(axis=1)
    # Flat coordinates start from the center of the box.
    origin = flat_rows @ (box_center - start)
    slope = flat.T @ g
    unit = 1.0 / np.sqrt(_PROXIMAL * np.maximum(top, np.abs(slope) / np.maximum(reach, 1e-6)))
    X = basis @ np.hstack([steep, flat * unit])
    return _ScaledComponent(
        X,
        start - basis @ (steep @ shift) + basis @ (flat @ origin),
        constant - float(0.5 * shift @ shift) + float(slope @ origin),
        np.concatenate([np.zeros(len(shift)), slope * unit]),
        np.concatenate([np.zeros(len(shift)), np.maximum(reach / unit, 1e-12)]),
    )
