"""A method of the common table on scenes of one shelf, each answer judged by the exact check."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.features import feature_map
from climbplan.bookshelf.methods.judge import Judge
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting, convex_solver
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import Scene
from climbplan.bookshelf.statement.points import features_of, theta_of
from climbplan.bookshelf.statement.stated import shelf_problem
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


def published_partitions(program: Program) -> tuple[Partition, ...]:
    """Partitions of a bookshelf program, over the frame that its centres may be in."""
    variables = program.variables
    center = variables["center"]
    cos, sin = variables["cos"], variables["sin"]
    found = [_arc(cos.start + k, sin.start + k) for k in range(math.prod(cos.shape))]
    found += each(variables["normal"], uniform(-1.0, 1.0, NORMALS, OVERLAP))
    vertex = variables["vertex"]
    index = np.arange(vertex.start, vertex.stop).reshape(vertex.shape)
    for axis, (low, high) in enumerate(zip(center.lower[0], center.upper[0], strict=True)):
        ends = pieces(np.linspace(low, high, CORNERS + 1))
        ends[0, 0] -= END
        ends[-1, 1] += END
        found += each(index[..., axis].ravel().tolist(), ends)
    return tuple(found)


def _arc(cos: int, sin: int) -> Partition:
    """Boxes around pieces of the half circle, one set of binaries for cosine and sine."""
    knots = np.linspace(-math.pi / 2, math.pi / 2, ANGLES + 1)
    c, s = np.cos(knots), np.sin(knots)
    low = np.column_stack([np.minimum(c[:-1], c[1:]), s[:-1]]) - OVERLAP
    high = np.column_stack([np.maximum(c[:-1], c[1:]), s[1:]]) + OVERLAP
    return together([cos, sin], low, high, covering=True)


_WHOLE = ("minlp-scip", "minlp-bonmin", "micp", "mpcc", "admm")
# Of solvers' points [mm, sines]: the check of the placement, at 0.01 mm, is what counts. Of
# candidates it alone: lines between books and products may be off where the books are not.
_LOOSE = 1e-3
_LEVER = 50.0  # [mm] half a book: what a change of a sine moves
_ADMM_WEIGHT = 10.0  # [mm^2 / mm] of a distance; 0.1 to 10 solved the eight scenes tried alike
_ADMM_RESIDUAL = 0.01  # of the variables' spans: 1.6 mm, the accuracy of the published solutions
_ADMM_GAP = 1e-2  # the published gap of the mixed-integer block


@dataclass(frozen=True)
class ByTable:
    """What scenes share is built for the first one."""

    judge: Judge
    problem: Problem
    method: Method
    settings: MethodSettings
    kept: SharedCache = field(default_factory=SharedCache)

    def solve(self, scene: Scene) -> SceneAnswer:
        """The method's placement, as far as it holds."""
        begin = time.perf_counter()
        return self.judge.answer(scene, self.found(scene), begin)

    def found(self, scene: Scene) -> MethodResult:
        """What the table says, with the fate of each candidate."""
        return solve_instance(self.problem, theta_of(scene), self.method, self.settings, self.kept)


@dataclass(frozen=True)
class WithFallback:
    """One method, and `exact` for scenes in which it finds no placement, in the time that is left.

    What the other one finds counts only if it holds in the judge's meaning.
    """

    first: SceneMethod
    other: ExactSolver
    judge: Judge

    def solve(self, scene: Scene) -> SceneAnswer:
        """The first method's placement, or whatever the other one says."""
        answer = self.first.solve(scene)
        if answer.placement is not None:
            return answer
        spare = self.other.solve(scene, self.other.limits.time - answer.seconds)
        if spare.placement is not None:
            judged = self.judge.judge_placement(scene, spare.placement)
            if judged.placement is None:
                return replace(answer, word=f"{answer.word}; `exact`: {judged.word}")
        return replace(
            spare,
            seconds=answer.seconds + spare.seconds,
            candidates=answer.candidates,
            word="; ".join(filter(None, (answer.word, "answered by `exact`", spare.word))),
        )


def whole_method(setting: MethodSetting, judge: Judge, library: Library | None = None) -> ByTable:
    """A method that needs no model; library: of `mpcc` from neighbours, `convex` and `knn`."""
    solver, program = setting.solver, judge.program
    problem = shelf_problem(judge.count, judge.shelf, judge.meaning, features_of, program)
    settings = replace(_settings(setting, judge), library=library)
    if solver.method == "mpcc":
        if solver.start == "zero":  # what a solver takes without a start
            zeros = {name: np.zeros(v.shape) for name, v in program.variables.items()}
            problem = replace(problem, start=lambda theta: zeros)
        settings = replace(settings, start="knn" if solver.start == "knn" else "manual")
        return ByTable(judge, problem, "mpcc", settings)
    if solver.method == "admm":
        bounds_alone = EnvelopeOptions(grid=McCormick(unbounded="open"))
        settings = replace(
            settings, solver=solver.solver, envelopes=bounds_alone, admm=_admm(program)
        )
        return ByTable(judge, problem, "admm", settings)
    if solver.method in ("convex", "knn"):
        settings = replace(settings, neighbours=solver.candidates or 50)
        return ByTable(judge, problem, "knn", replace(settings, pinned=_candidates(setting)))
    if solver.method == "micp":
        return ByTable(judge, problem, "micp", replace(settings, solver=solver.solver))
    if solver.method in ("minlp-scip", "minlp-bonmin"):
        return ByTable(judge, problem, solver.method, settings)
    raise ValueError(f"{solver.method} is no method without a model")


def model_method(model: StrategyModel, setting: MethodSetting, judge: Judge) -> ByTable:
    """A model as a method, on the shelf of the judge, whatever it was trained on."""
    solver = setting.solver
    features = feature_map(model_features(model), setting.shelf)
    problem = shelf_problem(judge.count, judge.shelf, judge.meaning, features, judge.program)
    settings = replace(_settings(setting, judge), model=model)
    if model.kind == "reduce":  # `solver` is of its programs; what they leave goes to DAQP
        settings = replace(settings, solver=solver.solver, neighbours=solver.candidates or 1)
    else:
        settings = replace(settings, neighbours=solver.candidates or 50)
    settings = replace(settings, pinned=_candidates(setting, model.kind == "reduce"))
    return ByTable(judge, problem, model.kind, settings)


def model_features(model: StrategyModel) -> ShelfFeatures:
    """What a model compares scenes by."""
    return "raw" if model.context["features"] == "raw" else "gaps"


def published_grid(judge: Judge) -> McCormick:
    """Envelopes on the published pieces, log2 N binaries each.

    In the meaning `contact` squares have true envelopes, so that bounds are valid; `published` has
    the published secants, and no bound.
    """
    squares: Squares = "envelope" if judge.meaning == "contact" else "secant"
    return McCormick(published_partitions(judge.program), "log2", squares)


def _settings(setting: MethodSetting, judge: Judge) -> MethodSettings:
    """What all methods have in common on a shelf; without a solver, and without a fallback."""
    solver = setting.solver
    return MethodSettings(
        gap=solver.gap,
        time_limit=solver.time_limit,
        tolerance=_LOOSE if setting.solver.method in _WHOLE else math.inf,
        own_tolerance=0.0,
        neighbours=solver.candidates,
        fallback=None,
        pinned=PipelineOptions(stop="first"),
        envelopes=EnvelopeOptions(grid=published_grid(judge)),
        mpcc=MpccOptions((Complementarity(coupling="big-m"),), STRAIGHT),
    )


def _candidates(setting: MethodSetting, reduced: bool = False) -> PipelineOptions:
    """Local SQP a candidate, or as published one convex program over the envelopes about it."""
    solver = setting.solver
    backend = "daqp" if reduced else convex_solver(solver.solver)
    return PipelineOptions(
        local="sqp" if solver.refinements or reduced else "envelopes",
        sqp=SqpOptions(backend=backend, steps=max(solver.refinements, 1)),
        good_enough=solver.gap_mm2,
    )


def _admm(program: Program) -> AdmmOptions:
    """Algorithm 3 of chapter 6.4, until both blocks agree to the published accuracy.

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
