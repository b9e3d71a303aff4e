"""The program of one meaning and shelf, and the exact check of its points."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer, Status
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene, compute_movement_cost
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import build_theta, extract_placement
from climbplan.bookshelf.statement.shelf_problem import check_solver_placement
from climbplan.bookshelf.statement.statement import build_bookshelf_program
from climbplan.methods.table import MethodResult
from climbplan.program import Program
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class PlacementEvaluation:
    """A placement that passes the exact check, or the reason why there is none."""

    placement: Placement | None
    objective: float  # [mm^2], infinite without a placement
    message: str = ""


class PlacementEvaluator:
    """Evaluates the answer of every method by the exact check of one meaning."""

    def __init__(self, count: int, shelf: Shelf, meaning: Meaning) -> None:
        self.program: Program = build_bookshelf_program(count, shelf, meaning)
        self.count, self.shelf = count, shelf
        self.meaning: Meaning = meaning

    def instance(self, scene: ShelfScene) -> Instance:
        """Return the program with the parameters of a scene."""
        return self.program.instantiate(build_theta(scene))

    def evaluate_point(self, scene: ShelfScene, x: Array) -> PlacementEvaluation:
        """Return the placement of a point (N,) if it passes the exact check."""
        return self.evaluate_placement(scene, extract_placement(self.program, scene, x))

    def evaluate_placement(self, scene: ShelfScene, placement: Placement) -> PlacementEvaluation:
        """Return the placement with its cost if it passes the exact check."""
        placement, check = check_solver_placement(scene, placement, self.shelf, self.meaning)
        if not check.passed[0]:
            return PlacementEvaluation(None, math.inf, check.explain(0).replace("\n", "; "))
        cost = compute_movement_cost(Scenes.of([scene]), placement.pose[None])
        return PlacementEvaluation(placement, float(cost[0]))

    def build_answer(
        self, scene: ShelfScene, method_result: MethodResult, begin: float
    ) -> SceneAnswer:
        """Build the checked answer of a method; begin: `time.perf_counter` seconds."""
        result = method_result.result
        evaluation = PlacementEvaluation(None, math.inf, _explain_failure(method_result))
        if result.x is not None:
            evaluation = self.evaluate_point(scene, result.x)
        if evaluation.placement is not None and method_result.fates:
            num_feasible = sum(tried.passed for tried in method_result.fates)
            message = f"{method_result.winner} of {method_result.tried} won, {num_feasible} held"
            evaluation = PlacementEvaluation(evaluation.placement, evaluation.objective, message)
        return SceneAnswer(
            status=_select_status(method_result, evaluation),
            placement=evaluation.placement,
            objective=evaluation.objective,
            bound=min(result.bound, evaluation.objective),
            seconds=time.perf_counter() - begin,
            nodes=result.nodes,
            candidates=max(method_result.tried, 1),
            message=evaluation.message,
        )


def _select_status(method_result: MethodResult, evaluation: PlacementEvaluation) -> Status:
    if evaluation.placement is not None:
        return "optimal" if method_result.result.status == "optimal" else "feasible"
    return "infeasible" if method_result.result.status == "infeasible" else "limit"


def _explain_failure(method_result: MethodResult) -> str:
    result = method_result.result
    if method_result.fates:
        return f"none of {method_result.tried} candidates of {method_result.method} holds"
    log_text = f" ({'; '.join(result.log)})" if result.log else ""
    return f"{result.solver} found none in {result.time:.1f} s{log_text}"
