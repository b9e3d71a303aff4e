"""Gurobi as a solver of instances, if it is installed and licensed."""

from __future__ import annotations

import time
from typing import Any

import gurobipy as gp
import numpy as np
from gurobipy import GRB

from climbplan.errors import MissingSolver
from climbplan.program.instance import Balls, Instance
from climbplan.solvers.mixed_integer_form import build_mixed_integer_form
from climbplan.solvers.result import Answer, SolverResult, judge_answer
from climbplan.solvers.tree.repair import repair_point

NAME = "gurobi"
TOLERANCE = 2e-6


def solve_gurobi(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
) -> SolverResult:
    """Solve an instance with Gurobi on one thread; arguments are those of the other solvers.

    Raises:
        MissingSolver: There is no licence.
        UsageError: A choice is not bounded.
    """
    begin = time.perf_counter()
    form = build_mixed_integer_form(instance)
    try:
        environment = gp.Env(params={"OutputFlag": 0})
    except gp.GurobiError as error:
        raise MissingSolver(f"gurobi is installed but cannot be used: {error}") from error
    with environment, gp.Model(instance.name, env=environment) as model:
        model.Params.Threads = 1
        model.Params.MIPGap = gap
        model.Params.FeasibilityTol = 1e-8
        if np.isfinite(time_limit):
            model.Params.TimeLimit = time_limit
        kind = np.where(instance.integer, GRB.BINARY, GRB.CONTINUOUS)
        low, high = form.box.lower, form.box.upper
        x = model.addMVar(instance.size, lb=low, ub=high, vtype=kind, name="x")
        half_hessian = 0.5 * instance.P
        model.setMObjective(half_hessian, instance.q, instance.constant, x, x, x, GRB.MINIMIZE)
        for bound, sense in ((instance.row_lower, ">"), (instance.row_upper, "<")):
            is_finite = np.flatnonzero(np.isfinite(bound))
            if len(is_finite):
                model.addMConstr(instance.A[is_finite], x, sense, bound[is_finite])
        for balls in instance.balls:
            _add_balls(model, x, balls)
        binaries = [model.addMVar(len(c.alternatives), vtype=GRB.BINARY) for c in instance.choices]
        for group in binaries:
            model.addConstr(group.sum() == 1)
        for entry in form.choice_rows:
            b = binaries[entry.choice]
            if entry.lower is not None:
                model.addConstr(entry.row @ x >= entry.lower[None] @ b)
            if entry.upper is not None:
                model.addConstr(entry.row @ x <= entry.upper[None] @ b)
        model.optimize()
        if model.Status == GRB.INF_OR_UNBD:
            model.Params.DualReductions = 0
            model.optimize()
        if model.Status == GRB.INTERRUPTED:
            raise KeyboardInterrupt  # Gurobi handles Ctrl-C itself
        solution = repair_point(instance, np.array(x.X)) if model.SolCount else None
        answer = Answer(
            x=solution,
            bound=_read_bound(model),
            infeasible=model.Status == GRB.INFEASIBLE,
            nodes=int(model.NodeCount),
            time=time.perf_counter() - begin,
            solver=NAME,
            log=(f"Gurobi {'.'.join(map(str, gp.gurobi.version()))}: status {model.Status}",),
        )
    return judge_answer(instance, answer, gap, tolerance)


def _read_bound(model: Any) -> float:
    """Return the lower bound that Gurobi has proved."""
    if model.IsMIP:
        return float(model.ObjBound)
    return float(model.ObjVal) if model.Status == GRB.OPTIMAL else -np.inf


def _add_balls(model: Any, x: Any, balls: Balls) -> None:
    """Add || F_k x + f_k || <= radius_k with explicit differences."""
    K, d = balls.f.shape
    if K == 0:
        return
    y = model.addMVar((K, d), lb=-GRB.INFINITY)
    model.addConstr(balls.F @ x + balls.f.ravel() == y.reshape(K * d))
    for k, radius in enumerate(balls.radius):
        model.addConstr(y[k] @ y[k] <= float(radius) ** 2)
