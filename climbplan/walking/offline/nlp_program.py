"""The nonlinear program of all knots, eqs. (8.14) to (8.25) and (8.30), compiled for IPOPT.

Variables are states 1 to N, forces, toes (x, y) 1 to N and contacts 0 to N, in this order; contacts
c in [0, 1] obey c (1 - c) <= eps. Starts, references and regions are parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from climbplan.reformulations.nlp_form import Bounds
from climbplan.solvers.ipopt.program import IpoptProgram
from climbplan.walking.dynamics import BodyNumbers, knot_step, plain_knot_step, rotation
from climbplan.walking.offline.pinned import FACETS
from climbplan.walking.task import ANGLE_RANGE, LEGS, STATE, WalkTask

EPSILON = 1e-3  # of c (1 - c) <= eps
ITERATIONS = 200  # infeasible gaits would use up IPOPT's own 3000
_STRIDE = 0.6  # [m] no toe moves further in one interval: the constant M of eq. (8.22)


@dataclass(frozen=True)
class NlpShape:
    """What a compiled program depends on; everything else is a parameter."""

    body: BodyNumbers
    center: tuple[float, ...]
    half: tuple[float, ...]
    force_limit: float
    friction: float
    knots: int
    step: float
    mean: bool
    weights: tuple[float, ...]
    lift: float
    least_contacts: int
    regions: int

    @classmethod
    def of(cls, task: WalkTask) -> NlpShape:
        body, weights = task.body, task.weights
        return cls(
            BodyNumbers.of(body),
            tuple(body.toe_center.ravel().tolist()),
            tuple(body.toe_half.tolist()),
            body.force_limit,
            task.ground.friction,
            task.knots,
            task.step,
            task.integrator == "mean",
            (
                *weights.velocity.tolist(),
                *weights.angles.tolist(),
                weights.height,
                weights.motion,
                weights.force_difference,
            ),
            task.lift,
            task.least_contacts,
            len(task.ground.height),
        )


@dataclass(frozen=True)
class CompiledNlp:
    """IPOPT with the bounds of variables and rows."""

    solver: IpoptProgram
    bounds: Bounds


@lru_cache(maxsize=4)
def compiled_nlp(shape: NlpShape) -> CompiledNlp:
    """The program, eqs. (8.14) to (8.25) and (8.30)."""
    N = shape.knots
    rows: list[tuple[Any, float, float]] = []  # expression, lower, upper
    state = [ca.SX.sym(f"x{n}", STATE) for n in range(1, N + 1)]
    force = [ca.SX.sym(f"f{n}", 3 * LEGS) for n in range(N)]
    spot = [ca.SX.sym(f"t{n}", 2 * LEGS) for n in range(1, N + 1)]
    contact = [ca.SX.sym(f"c{n}", LEGS) for n in range(N + 1)]
    start, toes0 = ca.SX.sym("x0", STATE), ca.SX.sym("toes0", 3 * LEGS)
    velocity, angles = ca.SX.sym("v_ref", 3, N), ca.SX.sym("a_ref", 3, N)
    height = ca.SX.sym("h_ref", N)
    level, clear = ca.SX.sym("level", LEGS, N), ca.SX.sym("clear", LEGS, N)
    low, high = ca.SX.sym("low", 2 * LEGS, N), ca.SX.sym("high", 2 * LEGS, N)
    center, half = np.reshape(shape.center, (LEGS, 3)), np.array(shape.half)
    w = shape.weights
    cost: Any = 0

    x = [start, *state]
    # Heights of toes: on the ground, or lifted, eq. (8.23)
    toes = [toes0]
    for n in range(1, N + 1):
        c, places = contact[n], []
        for i in range(LEGS):
            z = c[i] * level[i, n - 1] + (1 - c[i]) * clear[i, n - 1]
            places += [spot[n - 1][2 * i], spot[n - 1][2 * i + 1], z]
        toes.append(ca.vertcat(*places))
    step = ca.Function(
        "step",
        [s := ca.SX.sym("s", STATE), t := ca.SX.sym("t", 12), f := ca.SX.sym("f", 12)],
        [knot_step(shape.body, shape.step, float(shape.mean), s, t, f)],
    )
    plain = ca.Function(
        "plain", [s, t, f], [plain_knot_step(shape.body, shape.step, float(shape.mean), s, t, f)]
    )
    # Dynamics, eqs. (8.14) to (8.19)
    for n in range(N):
        rows.append((step(x[n], toes[n], force[n]) - x[n + 1], 0.0, 0.0))
    for n in range(N):
        for i in range(LEGS):
            fx, fy, fz = (force[n][3 * i + k] for k in range(3))
            c = contact[n][i]
            # Friction, eq. (8.18), as a pyramid inside the cone: smooth where forces vanish
            slope = shape.friction * np.cos(np.pi / FACETS)
            for k in range(FACETS):
                angle = 2 * np.pi * (k + 0.5) / FACETS
                rows.append((np.cos(angle) * fx + np.sin(angle) * fy - slope * fz, -np.inf, 0.0))
            # No force on lifted legs, eq. (8.23)
            rows.append((fz - shape.force_limit * c, -np.inf, 0.0))
            if shape.friction > 1:  # else within the pyramid already
                for component in (fx, fy):
                    rows.append((component - shape.force_limit * c, -np.inf, 0.0))
                    rows.append((component + shape.force_limit * c, 0.0, np.inf))
        if shape.least_contacts:
            rows.append((ca.sum1(contact[n]), float(shape.least_contacts), float(LEGS)))
    for n in range(1, N + 1):
        R = rotation(x[n][6:9])
        for i in range(LEGS):
            toe = toes[n][3 * i : 3 * i + 3]
            # Workspace, eqs. (8.20), (8.21)
            seen = R.T @ (toe - x[n][:3])
            for k in range(3):
                rows.append((seen[k], center[i, k] - half[k], center[i, k] + half[k]))
            # No slip, eq. (8.22)
            free = _STRIDE * (2 - contact[n][i] - contact[n - 1][i])
            for k in range(2):
                moved = toe[k] - toes[n - 1][3 * i + k]
                rows += [(moved - free, -np.inf, 0.0), (moved + free, 0.0, np.inf)]
            # Regions, eqs. (8.24), (8.25), those of the guess
            for k in range(2 if shape.regions > 1 else 0):
                slack = _STRIDE * (1 - contact[n][i])
                here = spot[n - 1][2 * i + k]
                rows.append((here - low[2 * i + k, n - 1] + slack, 0.0, np.inf))
                rows.append((here - high[2 * i + k, n - 1] - slack, -np.inf, 0.0))
        # Objective, eq. (8.30)
        for k in range(3):
            cost += w[k] * (x[n][3 + k] - velocity[k, n - 1]) ** 2
            cost += w[3 + k] * (x[n][6 + k] - angles[k, n - 1]) ** 2
        cost += w[6] * (x[n][2] - height[n - 1]) ** 2
        cost += w[7] * ca.sumsqr(x[n][:3] - x[n - 1][:3])
    for n in range(N):
        each = ca.reshape(force[n], 3, LEGS)
        cost += 2 * w[8] * (LEGS * ca.sumsqr(each) - ca.sumsqr(ca.sum2(each)))
    # Contacts as complementarity: c (1 - c) <= eps
    for n in range(N + 1):
        for i in range(LEGS):
            c = contact[n][i]
            rows.append((c * (1 - c), -np.inf, EPSILON))
    variables = ca.vertcat(*state, *force, *spot, *contact)
    numbers = ca.vertcat(
        start, toes0, *(ca.vec(m) for m in (velocity, angles)), height,
        *(ca.vec(m) for m in (level, clear, low, high)),
    )  # fmt: skip
    g = ca.vertcat(*(row for row, _, _ in rows))
    repeat = [row.numel() for row, _, _ in rows]
    settings = {
        "max_iter": ITERATIONS,
        "tol": 1e-4,
        "constr_viol_tol": 1e-5,
        # The guess is close to contacts of 0 and 1: do not push it away from them.
        "mu_strategy": "monotone",
        "mu_init": 0.01,
        "bound_push": 1e-4,
        "bound_frac": 1e-4,
    }
    # Second derivatives: those of the plain step, which are IPOPT's ten times cheaper
    price, weight = ca.SX.sym("price", g.numel()), ca.SX.sym("weight")
    curved = ca.vertcat(*(plain(x[n], toes[n], force[n]) for n in range(N)), g[STATE * N :])
    curvature, _ = ca.hessian(weight * cost + ca.dot(price, curved), variables)
    hessian = ca.Function("nlp_hess_l", [variables, numbers, weight, price], [ca.triu(curvature)])
    problem = {"x": variables, "p": numbers, "f": cost, "g": g}
    bound = np.concatenate(
        [
            np.tile([np.inf] * 6 + [ANGLE_RANGE] * 2 + [np.inf] * 4, N),
            np.full(3 * LEGS * N, shape.force_limit),
            np.full(2 * LEGS * N, np.inf),
        ]
    )
    lower = -bound
    first = STATE * N
    lower[first + 2 : first + 3 * LEGS * N : 3] = 0.0  # legs push
    return CompiledNlp(
        IpoptProgram("walk", problem, settings, hessian=hessian),
        Bounds(
            np.concatenate([lower, np.zeros(LEGS * (N + 1))]),
            np.concatenate([bound, np.ones(LEGS * (N + 1))]),
            np.repeat([low_ for _, low_, _ in rows], repeat),
            np.repeat([high_ for _, _, high_ in rows], repeat),
        ),
    )
