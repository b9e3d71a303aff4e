"""Which clusters' reduced programs mixed-integer solvers solve, beside the whole program.

Each cluster's program is put to the unseen scene that the classifier finds likeliest for it: that
is where it would be solved online. Infeasible is an answer too, that no member's integers serve the
scene over the envelopes; made exact, an optimum's integers go through the local SQP and the check.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.bookshelf.strategy_cases import Case
from climbplan.arrays import Array
from climbplan.bookshelf.methods.features import build_feature_map
from climbplan.bookshelf.methods.table_method import build_published_grid, select_model_features
from climbplan.bookshelf.statement.points import build_theta
from climbplan.learning.model import StrategyModel
from climbplan.learning.strategy import Candidate
from climbplan.methods.envelope_rounds import MICP_SOLVERS
from climbplan.methods.pipeline import CheckedPoint, PipelineOptions, run_pipeline
from climbplan.methods.reduced_programs import ReducedPrograms
from climbplan.program.instance import Instance
from climbplan.progress import Progress
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.registry import require

SOLVERS = ("highs", "scip")
WHOLE = -1
_CLUSTERS_A_WHOLE = 20  # of each whole program that is tried beside them


@dataclass(frozen=True)
class ProgramTrial:
    """One mixed-integer program, one solver, one scene."""

    solver: str  # of SOLVERS
    cluster: int  # WHOLE for the program that was not reduced
    scene: int
    members: int  # solved scenes in the cluster
    combinations: int  # of the stated binaries in it
    binaries: int
    status: str  # optimal, feasible, infeasible, limit
    seconds: float
    exact: float  # [mm^2] cost once made exact, infinite where it does not hold
    optimum: float  # [mm^2] of the scene

    @property
    def answered(self) -> bool:
        """Whether the solver has a point of the program or a proof that there is none."""
        return self.status in ("optimal", "feasible", "infeasible")


def cluster_programs(
    case: Case, model: StrategyModel, clusters: int, seconds: float, seed: int, report: Progress
) -> list[ProgramTrial]:
    """Solve the programs of some clusters, drawn at random, or of all, by both solvers.

    clusters: how many. seconds: limit of one program. Whole programs are solved beside them, one
    for each 20 clusters that were begun.
    """
    ranking = model.create_cluster_ranking()
    count = ranking.count
    chosen = np.arange(count)
    if clusters < count:
        chosen = np.sort(np.random.default_rng(seed).choice(count, clusters, replace=False))
    features = build_feature_map(select_model_features(model), case.method.shelf)
    grid = build_published_grid(case.evaluator)
    programs = [
        ReducedPrograms(ranking, grid.partitions, grid.squares, solver) for solver in SOLVERS
    ]
    instances = [case.evaluator.program.instantiate(build_theta(scene)) for scene in case.scenes]
    likely = np.array(
        [
            ranking.scorer.probabilities(features(build_theta(scene)))[chosen]
            for scene in case.scenes
        ]
    )  # (scenes, chosen)
    trials: list[ProgramTrial] = []
    for at, cluster in enumerate(chosen):
        report("programs of clusters", at / len(chosen))
        scene = int(np.argmax(likely[:, at]))
        reduction = programs[0].build_reduction(int(cluster))
        for one in programs:
            found = one.solve_cluster(instances[scene], int(cluster), seconds)
            trials.append(
                ProgramTrial(
                    one.solver,
                    int(cluster),
                    scene,
                    len(ranking.list_members(int(cluster))),
                    len(reduction.values),
                    found.record.binaries,
                    found.record.status,
                    found.record.seconds,
                    _made_exact(case, scene, instances[scene], found.candidate),
                    float(case.optimum[scene]),
                )
            )
    hard = np.argsort(-case.optimum, kind="stable")
    rng = np.random.default_rng(seed)
    most = min(-(-len(chosen) // _CLUSTERS_A_WHOLE), len(hard))
    # Scenes that need movement, not the worst of all
    for scene in rng.permutation(hard[: max(len(hard) // 4, most)])[:most]:
        report("whole programs", 0.0)
        for one in programs:
            trials.append(_whole(case, int(scene), instances[scene], one, seconds))
    return trials


def _whole(
    case: Case, scene: int, instance: Instance, programs: ReducedPrograms, seconds: float
) -> ProgramTrial:
    begin = time.perf_counter()
    enveloped = build_published_grid(case.evaluator).apply(instance)
    flat = BigM().apply(enveloped.instance)
    solve = require(MICP_SOLVERS[programs.solver]).load()
    found = solve(flat.instance, gap=programs.gap, time_limit=seconds)
    spent = time.perf_counter() - begin
    candidate = None
    if found.x is not None:
        x = enveloped.invert(flat.invert(found.x))
        candidate = Candidate(x, np.zeros(0, np.int64), x)
    ranking = programs.ranking
    return ProgramTrial(
        programs.solver,
        WHOLE,
        scene,
        ranking.library.size,
        len(np.unique(ranking.library.strategies, axis=0)),
        int(flat.instance.integer.sum()),
        found.status,
        spent,
        _made_exact(case, scene, instance, candidate),
        float(case.optimum[scene]),
    )


def _made_exact(case: Case, scene: int, instance: Instance, candidate: Candidate | None) -> float:
    if candidate is None:
        return math.inf

    def check(instance: Instance, x: Array) -> CheckedPoint:
        judged = case.evaluator.evaluate_point(case.scenes[scene], x)
        return CheckedPoint(judged.placement is not None, judged.objective, x, judged.message)

    return run_pipeline(instance, [candidate], PipelineOptions(local="sqp"), check).objective


def program_lines(trials: Sequence[ProgramTrial]) -> list[str]:
    """A table line a solver, clusters and whole programs apart."""
    lines = []
    for whole in (False, True):
        for solver in SOLVERS:
            mine = [t for t in trials if t.solver == solver and (t.cluster == WHOLE) == whole]
            if not mine:
                continue
            points = [t for t in mine if t.status in ("optimal", "feasible")]
            none = sum(t.status == "infeasible" for t in mine)
            holds = sum(math.isfinite(t.exact) for t in points)
            seconds = np.array([t.seconds for t in mine])
            binaries = [t.binaries for t in mine]
            lines.append(
                f"{'whole' if whole else 'reduced':<9}{solver:<7}{len(mine):>9}{len(points):>9}"
                f"{none:>12}{len(mine) - len(points) - none:>9}{holds:>8}"
                f"{f'{min(binaries)}-{max(binaries)}':>10}{np.median(seconds):>10.2f}"
                f"{np.quantile(seconds, 0.9):>8.1f}{seconds.max():>8.1f}"
            )
    return lines


PROGRAM_HEAD = (
    f"{'program':<9}{'solver':<7}{'programs':>9}{'solved':>9}{'infeasible':>12}{'nothing':>9}"
    f"{'exact':>8}{'binaries':>10}{'median s':>10}{'90 % s':>8}{'worst s':>8}"
)
