"""Motions held to in relaxed programs, for tests of bounds."""

from __future__ import annotations

import highspy
import numpy as np

from climbplan.solvers.highs.model import build_rows_model, create_highs
from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation, build_relaxation
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.task.task import WalkTask, WalkTrajectory

ANGLES, SPIN = np.array([0.1, 0.2, 0.1]), np.array([1.5, 3.0, 1.5])


def known(task: WalkTask, qps: int = 60) -> WalkAnswer:
    answer = search(task, SearchLimits(60.0, qps=qps))
    assert answer.trajectory is not None
    return answer


def lifted_cost(task: WalkTask, answer: WalkAnswer, spoil: float = 0.0) -> float:
    """Cost of the relaxed program with states, forces and binaries held to a motion's."""
    found = answer.trajectory
    assert found is not None
    tube = build_attitude_box(task, found.state, ANGLES, SPIN)
    assert tube.contains(found.state)
    program = build_relaxation(task, tube, answer.objective * 1.01, 2, 2, 1.5)
    return program_cost(program, found, spoil)


def program_cost(
    program: MixedIntegerRelaxation, found: WalkTrajectory, spoil: float = 0.0
) -> float:
    """As of `lifted_cost`."""
    model = build_rows_model(program.model, relaxed=True)
    low, high = np.array(model.col_lower_), np.array(model.col_upper_)
    for column, value in program.evaluate_point(found).items():
        low[column], high[column] = value - 1e-6, value + 1e-6
    if spoil:
        column = program.states[2][3].column  # a velocity that no force brings about
        low[column], high[column] = low[column] + spoil, high[column] + spoil
    model.col_lower_, model.col_upper_ = low, high
    solver = create_highs(30.0)
    solver.setOptionValue("primal_feasibility_tolerance", 1e-7)
    solver.passModel(model)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return np.inf
    return float(solver.getInfo().objective_function_value)
