"""One run of `fit-envelopes`: labelled terrains, envelopes by each method, the validation table.

Algorithm numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.envelopes.dataset_rows import LabelledRows, read_labelled_rows
from climbplan.climb.envelopes.distribution import build_distribution
from climbplan.climb.envelopes.first_stage import FirstStage
from climbplan.climb.envelopes.first_stage_labels import LabelledTerrains, build_labeller
from climbplan.climb.envelopes.fit import (
    TheoremConditions,
    Validation,
    build_heuristic_envelope,
    measure,
    prepare_stages,
    recentre_points,
    select_training_points,
)
from climbplan.climb.envelopes.rows import TerrainDataset, collect_rows
from climbplan.climb.envelopes.statement import PostureStatement, build_posture_statement
from climbplan.climb.envelopes.terrains import TerrainDistribution
from climbplan.climb.schema.envelopes import EnvelopeFitSpec, EnvelopesSpec
from climbplan.climb.schema.envelopes_loading import LoadedEnvelopes
from climbplan.learning.envelope_box import EnvelopeSet, FirstStageLabels
from climbplan.learning.envelope_clustering import fit_clusters
from climbplan.learning.envelope_genetic import GeneticOptions, GeneticResult, run_genetic_search
from climbplan.progress import Progress
from climbplan.robots.model import Robot
from climbplan.store.dataset_file import read_dataset_file

GROWTHS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.18, 0.25)  # of each side, in widths


@dataclass(frozen=True)
class FittedEnvelopes:
    """The envelopes of one method with what was measured of them on held-out terrains."""

    method: str
    envelopes: EnvelopeSet
    validation: Validation
    conditions: TheoremConditions
    seconds: float  # CPU time of this process spent on finding them [s]


@dataclass(frozen=True)
class EnvelopeRun:
    """All envelopes of one run."""

    limb_names: tuple[str, ...]
    position_scale: float  # P [m]
    fitted: tuple[FittedEnvelopes, ...]
    fitness: Array  # (G, 3) mean, spread and best of each generation, none without the search
    training: TerrainDataset  # points of feasible terrains as they were clustered
    held_out: TerrainDataset
    fingerprint: str  # sha256 of the training terrains and labels
    timings: dict[str, float]  # [s]


@dataclass
class _Clock:
    """Seconds of each stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    begin: float = field(default_factory=time.perf_counter)

    def done(self, stage: str) -> None:
        self.seconds[stage] = time.perf_counter() - self.begin
        self.begin = time.perf_counter()


def fit_envelopes(
    loaded: LoadedEnvelopes, robot: Robot, report: Progress, jobs: int = 1
) -> EnvelopeRun:
    """Draw or read terrains, fit and validate; the result does not depend on `jobs`.

    Raises UsageError for a dataset that does not fit the spec.
    """
    spec = loaded.spec
    terrains = build_distribution(spec.terrain, robot)
    statement = build_posture_statement(terrains.legs)
    clock = _Clock()
    rows = _collect_rows(loaded, terrains, statement, report)
    training, held_out = rows.training, rows.held_out
    clock.done("data")
    fit, fingerprint = spec.fit, _compute_fingerprint(training)
    prepared = prepare_stages(statement, training, fit.first_stage)
    envelopes_by_method: dict[str, EnvelopeSet] = {}
    cpu_seconds: dict[str, float] = {}
    method_wanted = fit.method
    begin = time.process_time()
    if method_wanted in ("all", "heuristic", "genetic"):
        envelopes_by_method["heuristic"] = (build_heuristic_envelope(terrains),) * fit.envelopes
        cpu_seconds["heuristic"] = time.process_time() - begin
    recentred_rows = training
    if method_wanted in ("all", "clustering", "genetic"):
        begin = time.process_time()
        recentred_rows = recentre_points(training, prepared, partial(report, "recentring"))
        labelled = _build_labelled(training, recentred_rows, terrains, fit)
        labels = build_labeller(labelled, prepared)
        envelopes_by_method["clustering"] = fit_by_clustering(recentred_rows, labels, spec)
        cpu_seconds["clustering"] = time.process_time() - begin
        clock.done("clustering")
    fitness = np.zeros((0, 3))
    if method_wanted in ("all", "genetic"):
        begin = time.process_time()
        labelled = _build_labelled(training, recentred_rows, terrains, fit)
        labels = build_labeller(labelled, prepared, jobs)
        first = list(envelopes_by_method.values())
        searched = _run_search(labels, training, first, fit, spec.seed, report)
        envelopes_by_method["genetic"] = searched.envelopes
        cpu_seconds["genetic"] = time.process_time() - begin
        history = searched.fitness_mean, searched.fitness_spread, searched.fitness_best
        fitness = np.stack(history, axis=1)
        clock.done("genetic")
    checked = prepare_stages(statement, held_out, fit.first_stage)
    fitted = []
    for num_done, (method, envelopes) in enumerate(envelopes_by_method.items()):
        report("validation", num_done / len(envelopes_by_method))
        if method_wanted in ("all", method):
            fitted.append(_validate(method, envelopes, held_out, checked, cpu_seconds[method]))
    clock.done("validation")
    return EnvelopeRun(
        limb_names=terrains.legs.names,
        position_scale=terrains.legs.length,
        fitted=tuple(fitted),
        fitness=fitness,
        training=recentred_rows,
        held_out=held_out,
        fingerprint=fingerprint,
        timings=clock.seconds,
    )


def _validate(
    method: str,
    envelopes: EnvelopeSet,
    held_out: TerrainDataset,
    stages: list[FirstStage],
    seconds: float,
) -> FittedEnvelopes:
    """Measure the envelopes of a method on held-out terrains; heuristic ones are all alike."""
    different = envelopes[:1] if method == "heuristic" else envelopes
    measured = measure(different, held_out, stages)
    return FittedEnvelopes(method, different, measured.validation, measured.conditions, seconds)


def _collect_rows(
    loaded: LoadedEnvelopes,
    terrains: TerrainDistribution,
    statement: PostureStatement,
    report: Progress,
) -> LabelledRows:
    """Return training and held-out terrains: of a dataset, or drawn."""
    data, seed = loaded.spec.data, loaded.spec.seed
    if data.dataset is not None:
        report("data", 0.0)
        path = loaded.directory / data.dataset
        return read_labelled_rows(read_dataset_file(path), path, terrains)

    def draw(stage: str, seed_offset: int, feasible: int, infeasible: int) -> TerrainDataset:
        return collect_rows(
            terrains,
            statement,
            feasible,
            infeasible,
            2 * seed + seed_offset,  # held-out terrains share none with the training
            lambda share: report(stage, share),
        )

    return LabelledRows(
        draw("training", 1, data.training_feasible, data.training_infeasible),
        draw("held-out", 2, data.validation_feasible, data.validation_infeasible),
    )


def _build_labelled(
    training: TerrainDataset,
    recentred_rows: TerrainDataset,
    terrains: TerrainDistribution,
    fit: EnvelopeFitSpec,
) -> LabelledTerrains:
    """Return training terrains with the points that were found, and those they were moved to."""
    feasible_points = np.stack([training.point, recentred_rows.point], axis=1)
    feasible_points[~training.feasible] = np.nan
    return LabelledTerrains(
        terrains.legs,
        training.terrain,
        fit.first_stage,
        feasible_points,
        _compute_fingerprint(training),
    )


def fit_by_clustering(
    recentred_rows: TerrainDataset, labels: FirstStageLabels, spec: EnvelopesSpec
) -> EnvelopeSet:
    """Return Algorithm 2, its boxes grown until P1 calls enough training terrains feasible."""
    good, bad = select_training_points(recentred_rows)
    count = spec.fit.envelopes
    clusters = fit_clusters(good, bad, count, spec.fit.likelihood, spec.seed)
    fitted = [cluster.envelope for cluster in clusters]
    feasible = np.flatnonzero(recentred_rows.feasible)
    for growth in GROWTHS:
        envelopes = tuple(e.widen(growth) for e in fitted)
        if labels([envelopes], feasible)[0].mean() >= spec.fit.least_feasible:
            break
    return envelopes


def _run_search(
    labels: FirstStageLabels,
    training: TerrainDataset,
    first: list[EnvelopeSet],
    fit: EnvelopeFitSpec,
    seed: int,
    report: Progress,
) -> GeneticResult:
    options = GeneticOptions(
        population=fit.genetic.population,
        generations=fit.genetic.generations,
        terrains=fit.genetic.terrains,
        delta=fit.genetic.delta,
    )
    return run_genetic_search(
        labels, training.feasible, first, options, seed, lambda share: report("genetic", share)
    )


def _compute_fingerprint(rows: TerrainDataset) -> str:
    return hashlib.sha256(rows.terrain.tobytes() + rows.feasible.tobytes()).hexdigest()
