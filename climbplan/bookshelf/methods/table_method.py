"""Methods of the common table on scenes of one shelf, with the exact check of each answer.

Published methods, and chapter and algorithm numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.features import build_feature_map
from climbplan.bookshelf.methods.placement_evaluator import PlacementEvaluator
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting, select_convex_solver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import ShelfScene
from climbplan.bookshelf.statement.points import build_theta, compute_features
from climbplan.bookshelf.statement.shelf_problem import build_shelf_problem
from climbplan.learning.library import Library
from climbplan.learning.model import StrategyModel
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.pipeline import PipelineOptions
from climbplan.methods.table import MethodResult, solve_instance
from climbplan.methods.task import Method, MethodSettings, MpccOptions, SharedCache
from climbplan.program import Problem, Program
from climbplan.reformulations.complementarity import Complementarity
from climbplan.reformulations.envelopes import Squares
from climbplan.reformulations.grids import Partition, each, pieces, together, uniform
from climbplan.reformulations.mccormick import McCormick
from climbplan.schema.learning.strategy import ShelfFeatures
from climbplan.solvers.admm import AdmmOptions
from climbplan.solvers.ipopt.mpcc import STRAIGHT
from climbplan.solvers.sqp.method import SqpOptions

# The published pieces of bilinear terms (code of arXiv 2110.00666): angles in eighths of the half
# turn, components of normals in eighths of [-1, 1], corner coordinates in quarters of the frame;
# with log2 encoding 3 binaries an angle, 6 a line, 4 a corner
ANGLES = 8
NORMALS = 8
CORNERS = 4
OVERLAP = 0.05  # of cosines, sines and normals
END = 1.5  # [mm] beyond the frame


def build_published_partitions(program: Program) -> tuple[Partition, ...]:
    """Build the published partitions of a bookshelf program over the frame of its centres."""
    variables = program.variables
    center = variables["center"]
    cos, sin = variables["cos"], variables["sin"]
    partitions = [
        _build_arc_partition(cos.start + k, sin.start + k) for k in range(math.prod(cos.shape))
    ]
    partitions += each(variables["normal"], uniform(-1.0, 1.0, NORMALS, OVERLAP))
    vertex = variables["vertex"]
    index = np.arange(vertex.start, vertex.stop).reshape(vertex.shape)
    for axis, (low, high) in enumerate(zip(center.lower[0], center.upper[0], strict=True)):
        ends = pieces(np.linspace(low, high, CORNERS + 1))
        ends[0, 0] -= END
        ends[-1, 1] += END
        partitions += each(index[..., axis].ravel().tolist(), ends)
    return tuple(partitions)


def _build_arc_partition(cos: int, sin: int) -> Partition:
    """Build boxes around arcs of the half circle, with one set of binaries for cosine and sine."""
    knots = np.linspace(-math.pi / 2, math.pi / 2, ANGLES + 1)
    c, s = np.cos(knots), np.sin(knots)
    low = np.column_stack([np.minimum(c[:-1], c[1:]), s[:-1]]) - OVERLAP
    high = np.column_stack([np.maximum(c[:-1], c[1:]), s[1:]]) + OVERLAP
    return together([cos, sin], low, high, covering=True)


_WHOLE = ("minlp-scip", "minlp-bonmin", "mccormick", "mpcc", "admm")
# Of solvers' points [mm, sines]: the check of the placement, at 0.01 mm, is what counts. Of
# candidates it alone: lines between books and products may be off where the books are not.
_LOOSE = 1e-3
_LEVER = 50.0  # [mm] half a book: what a change of a sine moves
_ADMM_WEIGHT = 10.0  # [mm^2 / mm] of a distance; 0.1 to 10 solved the eight scenes tried alike
_ADMM_RESIDUAL = 0.01  # of the variables' spans: 1.6 mm, the accuracy of the published solutions
_ADMM_GAP = 1e-2  # the published gap of the mixed-integer block


@dataclass(frozen=True)
class TableMethod:
    """A method of the common table; what scenes share is built for the first one."""

    evaluator: PlacementEvaluator
    problem: Problem
    method: Method
    settings: MethodSettings
    cache: SharedCache = field(default_factory=SharedCache)

    def solve(self, scene: ShelfScene) -> SceneAnswer:
        """Solve a scene; a placement that fails the exact check is dropped."""
        begin = time.perf_counter()
        return self.evaluator.build_answer(scene, self.find_candidates(scene), begin)

    def find_candidates(self, scene: ShelfScene) -> MethodResult:
        """Return the method's own result, with the outcome of each candidate."""
        return solve_instance(
            self.problem, build_theta(scene), self.method, self.settings, self.cache
        )


@dataclass(frozen=True)
class WithFallback:
    """A method with `exact` for scenes without a placement, in the time that remains.

    A placement of `exact` counts only if it passes the check of the evaluator's meaning.
    """

    first: SceneMethod
    exact: ExactSolver
    evaluator: PlacementEvaluator

    def solve(self, scene: ShelfScene) -> SceneAnswer:
        """Return the first method's placement, or the answer of `exact`."""
        answer = self.first.solve(scene)
        if answer.placement is not None:
            return answer
        exact_answer = self.exact.solve(scene, self.exact.limits.time - answer.seconds)
        if exact_answer.placement is not None:
            evaluation = self.evaluator.evaluate_placement(scene, exact_answer.placement)
            if evaluation.placement is None:
                return replace(answer, message=f"{answer.message}; `exact`: {evaluation.message}")
        return replace(
            exact_answer,
            seconds=answer.seconds + exact_answer.seconds,
            candidates=answer.candidates,
            message="; ".join(
                filter(None, (answer.message, "answered by `exact`", exact_answer.message))
            ),
        )


def build_method(
    setting: MethodSetting, evaluator: PlacementEvaluator, library: Library | None = None
) -> TableMethod:
    """Build a method that needs no trained model.

    Args:
        setting: shelf, meaning and solver options.
        evaluator: the program of the scenes and its exact check.
        library: solved scenes for `pinned`, `knn`, and `mpcc` that starts from neighbours.
    """
    solver, program = setting.solver, evaluator.program
    problem = build_shelf_problem(
        evaluator.count, evaluator.shelf, evaluator.meaning, compute_features, program
    )
    settings = replace(_build_settings(setting, evaluator), library=library)
    if solver.method == "mpcc":
        if solver.start == "zero":  # what a solver takes without a start
            zeros = {name: np.zeros(v.shape) for name, v in program.variables.items()}
            problem = replace(problem, start=lambda theta: zeros)
        settings = replace(settings, start="knn" if solver.start == "knn" else "manual")
        return TableMethod(evaluator, problem, "mpcc", settings)
    if solver.method == "admm":
        bounds_alone = EnvelopeOptions(grid=McCormick(unbounded="open"))
        settings = replace(
            settings,
            solver=solver.solver,
            envelopes=bounds_alone,
            admm=_build_admm_options(program),
        )
        return TableMethod(evaluator, problem, "admm", settings)
    if solver.method in ("pinned", "knn"):
        settings = replace(settings, neighbours=solver.max_candidates or 50)
        return TableMethod(
            evaluator, problem, "knn", replace(settings, pinned=_build_pipeline_options(setting))
        )
    if solver.method == "mccormick":
        return TableMethod(evaluator, problem, "mccormick", replace(settings, solver=solver.solver))
    if solver.method in ("minlp-scip", "minlp-bonmin"):
        return TableMethod(evaluator, problem, solver.method, settings)
    raise ValueError(f"{solver.method} is no method without a model")


def build_model_method(
    model: StrategyModel, setting: MethodSetting, evaluator: PlacementEvaluator
) -> TableMethod:
    """Build the method of a trained model for the evaluator's shelf, whatever it was trained on."""
    solver = setting.solver
    features = build_feature_map(select_model_features(model), setting.shelf)
    problem = build_shelf_problem(
        evaluator.count, evaluator.shelf, evaluator.meaning, features, evaluator.program
    )
    settings = replace(_build_settings(setting, evaluator), model=model)
    if model.kind == "reduce":  # `solver` is of its programs; what they leave goes to DAQP
        settings = replace(settings, solver=solver.solver, neighbours=solver.max_candidates or 1)
    else:
        settings = replace(settings, neighbours=solver.max_candidates or 50)
    settings = replace(settings, pinned=_build_pipeline_options(setting, model.kind == "reduce"))
    return TableMethod(evaluator, problem, model.kind, settings)


def select_model_features(model: StrategyModel) -> ShelfFeatures:
    """Return the kind of features by which a model compares scenes."""
    return "raw" if model.context["features"] == "raw" else "gaps"


def build_published_grid(evaluator: PlacementEvaluator) -> McCormick:
    """Build McCormick envelopes on the published pieces, log2 N binaries each.

    In the meaning `contact` squares have true envelopes, so that bounds are valid; `published` has
    the published secants, and no bound.
    """
    squares: Squares = "envelope" if evaluator.meaning == "contact" else "secant"
    return McCormick(build_published_partitions(evaluator.program), "log2", squares)


def _build_settings(setting: MethodSetting, evaluator: PlacementEvaluator) -> MethodSettings:
    """Build the settings that all methods share, without a solver and without a fallback."""
    solver = setting.solver
    return MethodSettings(
        gap=solver.gap,
        time_limit=solver.time_limit,
        tolerance=_LOOSE if setting.solver.method in _WHOLE else math.inf,
        own_tolerance=0.0,
        neighbours=solver.max_candidates,
        fallback=None,
        pinned=PipelineOptions(stop="first"),
        envelopes=EnvelopeOptions(grid=build_published_grid(evaluator)),
        mpcc=MpccOptions((Complementarity(coupling="big-m"),), STRAIGHT),
    )


def _build_pipeline_options(setting: MethodSetting, reduced: bool = False) -> PipelineOptions:
    """Build options of a candidate: local SQP, or the published convex program over envelopes."""
    solver = setting.solver
    backend = "daqp" if reduced else select_convex_solver(solver.solver)
    return PipelineOptions(
        local="sqp" if solver.max_refinements or reduced else "envelopes",
        sqp=SqpOptions(backend=backend, steps=max(solver.max_refinements, 1)),
        good_enough=solver.gap_mm2,
    )


def _build_admm_options(program: Program) -> AdmmOptions:
    """Build options of ADMM (algorithm 3, chapter 6.4) with the published consensus accuracy.

    The published weights are not known. Ours: millimetres as they are, cosines, sines and normals
    by the length of a book, so that the cost at the start, next to nothing, does not set them.
    """
    weight = np.zeros(max(v.stop for v in program.variables.values()))
    for variable in program.variables.values():
        unit = 1.0 if variable.unit == "mm" else _LEVER**2
        if not variable.integer:
            weight[variable.start : variable.stop] = _ADMM_WEIGHT * unit
    return AdmmOptions(
        weight=weight, norm="l1", residual=_ADMM_RESIDUAL, mixed_integer_gap=_ADMM_GAP
    )
