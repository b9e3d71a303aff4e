"""Solved cart-poles for tests: contacts of a rollout under feedback, improved by flipping runs."""

from __future__ import annotations

import cart_pole as model
import numpy as np
from scipy.linalg import solve_discrete_are

from climbplan.arrays import Array
from climbplan.learning.library import Library, ProgramSignature
from climbplan.program import Program
from climbplan.solvers.sqp.method import SqpSolver

DAMPING = 0.1
NONE = np.zeros(0, np.int64)
_TERMINAL = solve_discrete_are(model.A, model.B, model.Q, model.R)
_GAIN = np.linalg.solve(model.R + model.B.T @ _TERMINAL @ model.B, model.B.T @ _TERMINAL @ model.A)


def damped() -> Program:
    """The bilinear cart-pole."""
    return model.cart_pole(DAMPING)


def features(theta: dict[str, Array]) -> Array:
    """What neighbours are compared by, (6,)."""
    return np.concatenate([theta["start"], theta["walls"]])


def rollout(program: Program, theta: dict[str, Array], gain: float = 1.0) -> Array:
    """A trajectory under feedback; its contacts are consistent, its bounds may be violated."""
    x = np.zeros((model.HORIZON + 1, 4))
    x[0] = theta["start"]
    u, force = np.zeros((model.HORIZON, 1)), np.zeros((model.HORIZON, 2))
    for k in range(model.HORIZON):
        tip, rate = x[k, 0] - model.LENGTH * x[k, 1], x[k, 2] - model.LENGTH * x[k, 3]
        depth = tip * model.SIDE - theta["walls"]
        law = model.STIFFNESS * depth * (1 + DAMPING * rate * model.SIDE)
        force[k] = np.where(depth > 0, law, 0.0)
        u[k] = np.clip(-gain * _GAIN @ x[k], -model.MOST_INPUT, model.MOST_INPUT)
        x[k + 1] = model.A @ x[k] + model.B @ u[k] + model.E @ force[k]
    tips = x[:-1, 0] - model.LENGTH * x[:-1, 1]
    return program.point(
        {
            "state": x,
            "input": u,
            "force": force,
            "touch": tips[:, None] * model.SIDE > theta["walls"],
            "tip_rate": x[:-1, 2] - model.LENGTH * x[:-1, 3],
            "tip": tips,
        }
    )


def solved(program: Program, theta: dict[str, Array]) -> tuple[Array, float] | None:
    """The best point found from contacts of several rollouts, one step longer and shorter."""
    instance = program.instantiate(theta)
    solver = SqpSolver(instance)
    touch = program.variables["touch"]
    best: tuple[Array, float] | None = None
    seen: set[bytes] = set()
    for gain in (1.0, 0.5, 1.5, 0.0):
        start = rollout(program, theta, gain)
        for pattern in _nearby(program.value("touch", start)):
            if pattern.tobytes() in seen:
                continue
            seen.add(pattern.tobytes())
            x = start.copy()
            x[touch.start : touch.stop] = pattern.ravel()
            found = solver.solve(x, NONE, x, np.inf if best is None else best[1])
            if (
                found.feasible
                and found.x is not None
                and instance.violation(found.x) <= 1e-5
                and (best is None or found.objective < best[1])
            ):
                best = found.x, found.objective
    return best


def _nearby(touch: Array) -> list[Array]:
    """Contacts that begin or end one or two steps earlier or later."""
    out = [touch]
    for side in range(2):
        steps = np.flatnonzero(touch[:, side] > 0.5)
        first, last = (steps[0], steps[-1]) if len(steps) else (0, -1)
        for a in range(max(first - 2, 0), first + 3):
            for b in range(last - 2, min(last + 3, len(touch))):
                other = touch.copy()
                other[:, side] = 0.0
                other[a : b + 1, side] = 1.0
                out.append(other)
    return out


def library(program: Program, count: int, seed: int) -> tuple[Library, list[dict[str, Array]]]:
    """Solved problems, and the parameters of those that could be."""
    rng = np.random.default_rng(seed)
    rows: list[tuple[Array, Array, float]] = []
    thetas = []
    for _ in range(count):
        theta = model.random_theta(rng)
        answer = solved(program, theta)
        if answer is not None:
            rows.append((features(theta), *answer))
            thetas.append(theta)
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    return Library.of(ProgramSignature.of(program), parts[0], parts[1], parts[2]), thetas
