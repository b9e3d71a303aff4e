"""Methods that take integers from a trained model: ranked strategies, or reduced programs."""

from __future__ import annotations

import time
from dataclasses import dataclass

from climbplan.bookshelf.answer import SceneAnswer
from climbplan.bookshelf.methods.envelope_grids import published_partitions
from climbplan.bookshelf.methods.features import Features, feature_count, feature_map
from climbplan.bookshelf.methods.learned import Convex, answer_of, check_of
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.setting import MethodSetting, convex_solver
from climbplan.bookshelf.methods.shelf_context import require_context
from climbplan.bookshelf.methods.statement import Judge
from climbplan.bookshelf.points import theta_of
from climbplan.bookshelf.scene import Array, Scene
from climbplan.errors import UsageError
from climbplan.learning.model import StrategyModel
from climbplan.learning.model_file import read_model
from climbplan.methods.pipeline import Checked, PipelineOptions, PipelineResult, run_pipeline
from climbplan.methods.reduced_programs import ReducedPrograms
from climbplan.program.instance import Instance
from climbplan.solvers.sqp.method import SqpOptions
from climbplan.spec.fits.strategy import ShelfFeatures

MORE_CLUSTERS = 4  # that are tried while no placement was found


@dataclass(frozen=True)
class ReducedScenes:
    """The reduced mixed-integer programs of the likeliest clusters, made exact; the best wins.

    clusters: how many are solved in any case.
    """

    judge: Judge
    programs: ReducedPrograms
    features: Features
    clusters: int
    seconds: float
    gap_mm2: float
    sqp: SqpOptions

    def solve(self, scene: Scene) -> SceneAnswer:
        """The best placement of the clusters that were solved."""
        begin = time.perf_counter()
        return answer_of(self.judge, scene, self.tried(scene), begin, "reduced programs")

    def tried(self, scene: Scene) -> PipelineResult:
        """What became of each candidate."""
        theta = theta_of(scene)
        instance = self.judge.program.at(theta)
        judge, found_one = check_of(self.judge, scene), [False]

        def check(instance: Instance, x: Array) -> Checked:
            checked = judge(instance, x)
            found_one[0] = found_one[0] or checked.passed
            return checked

        candidates = self.programs.candidates(
            instance,
            self.features(theta),
            self.clusters,
            self.seconds,
            MORE_CLUSTERS,
            lambda: found_one[0],
        )
        # The programs keep the time limit; what the last one found is made exact in any case.
        options = PipelineOptions(sqp=self.sqp, good_enough=self.gap_mm2)
        return run_pipeline(instance, candidates, options, check)


def trained_method(setting: MethodSetting, count: int, judge: Judge) -> SceneMethod:
    """The method of a model file, without a fallback.

    Raises UsageError for a model of another method, shelf, meaning or number of books,
    PlanFileError for a damaged file.
    """
    solver = setting.solver
    if solver.model is None:
        raise UsageError(
            f"method {solver.method!r} needs a trained strategy: give a model file of "
            "`climbplan fit-strategy` as solver.model.file"
        )
    path = setting.directory / solver.model.file
    model = read_model(path).model
    if model.kind != solver.method:
        raise UsageError(f"{path}: a model of kind {model.kind!r}, method is {solver.method!r}")
    require_context(model.context, setting.shelf, setting.meaning, count, str(path))
    try:
        model.library.require(judge.program, feature_count(_features_of(model), count))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return model_method(model, setting, judge)


def _features_of(model: StrategyModel) -> ShelfFeatures:
    return "raw" if model.context["features"] == "raw" else "gaps"


def model_method(model: StrategyModel, setting: MethodSetting, judge: Judge) -> SceneMethod:
    """A model as a method, on the shelf of the judge, whatever it was trained on."""
    solver, shelf = setting.solver, setting.shelf
    features = feature_map(_features_of(model), shelf)
    if model.kind == "reduce":
        programs = ReducedPrograms(
            ranking=model.clusters(),
            partitions=published_partitions(judge.program),
            squares="envelope" if judge.meaning == "contact" else "secant",
            solver=solver.solver or "highs",
            seconds=solver.time_limit,
        )
        sqp = SqpOptions(steps=max(solver.refinements, 1))
        clusters = solver.candidates or 1
        return ReducedScenes(
            judge, programs, features, clusters, solver.time_limit, solver.gap_mm2, sqp
        )
    return Convex(
        judge=judge,
        strategy=model.strategy(),
        candidates=solver.candidates or 50,
        refinements=solver.refinements,
        backend=convex_solver(solver.solver),
        seconds=solver.time_limit,
        gap_mm2=solver.gap_mm2,
        features=features,
        name=model.kind,
    )
