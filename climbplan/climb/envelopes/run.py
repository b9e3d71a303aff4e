"""One run of `fit-envelopes`: labelled terrains, envelopes by each method, the validation table."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.envelopes.dataset_rows import LabelledRows, labelled_rows
from climbplan.climb.envelopes.distribution import terrains_of
from climbplan.climb.envelopes.first_stage_labels import LabelledTerrains, labels_of
from climbplan.climb.envelopes.fit import (
    Conditions,
    Validation,
    heuristic,
    measure,
    recentred,
    stages,
    training_points,
)
from climbplan.climb.envelopes.rows import Rows, collect_rows
from climbplan.climb.envelopes.statement import PostureStatement, posture_statement
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
    conditions: Conditions
    seconds: float  # CPU time of this process spent on finding them [s]


@dataclass(frozen=True)
class EnvelopeRun:
    """All envelopes of one run."""

    limb_names: tuple[str, ...]
    position_scale: float  # P [m]
    fitted: tuple[FittedEnvelopes, ...]
    fitness: Array  # (G, 3) mean, spread and best of each generation, none without the search
    training: Rows  # points of feasible terrains as they were clustered
    held_out: Rows
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
    terrains = terrains_of(spec.terrain, robot)
    statement = posture_statement(terrains.legs)
    clock = _Clock()
    rows = _rows(loaded, terrains, statement, report)
    training, held_out = rows.training, rows.held_out
    clock.done("data")
    fit, fingerprint = spec.fit, _fingerprint(training)
    prepared = stages(statement, training, fit.first_stage)
    found: dict[str, EnvelopeSet] = {}
    spent: dict[str, float] = {}
    wanted = fit.method
    begin = time.process_time()
    if wanted in ("all", "heuristic", "genetic"):
        found["heuristic"] = (heuristic(terrains),) * fit.envelopes
        spent["heuristic"] = time.process_time() - begin
    moved = training
    if wanted in ("all", "clustering", "genetic"):
        begin = time.process_time()
        moved = recentred(training, prepared, lambda share: report("recentring", share))
        labels = labels_of(_labelled(training, moved, terrains, fit), prepared)
        found["clustering"] = clustered(moved, labels, spec)
        spent["clustering"] = time.process_time() - begin
        clock.done("clustering")
    fitness = np.zeros((0, 3))
    if wanted in ("all", "genetic"):
        begin = time.process_time()
        labels = labels_of(_labelled(training, moved, terrains, fit), prepared, jobs)
        searched = _searched(labels, training, list(found.values()), fit, spec.seed, report)
        found["genetic"] = searched.envelopes
        spent["genetic"] = time.process_time() - begin
        fitness = np.stack(
            [searched.fitness_mean, searched.fitness_spread, searched.fitness_best], axis=1
        )
        clock.done("genetic")
    checked = stages(statement, held_out, fit.first_stage)
    fitted: list[FittedEnvelopes] = []
    for done, (method, envelopes) in enumerate(found.items()):
        report("validation", done / len(found))
        if wanted not in ("all", method):
            continue
        if method == "heuristic":
            envelopes = envelopes[:1]  # all alike
        found_out = measure(envelopes, held_out, checked)
        fitted.append(
            FittedEnvelopes(
                method, envelopes, found_out.validation, found_out.conditions, spent[method]
            )
        )
    clock.done("validation")
    legs, seconds = terrains.legs, clock.seconds
    return EnvelopeRun(
        legs.names, legs.length, tuple(fitted), fitness, moved, held_out, fingerprint, seconds
    )


def _rows(
    loaded: LoadedEnvelopes,
    terrains: TerrainDistribution,
    statement: PostureStatement,
    report: Progress,
) -> LabelledRows:
    """Training and held-out terrains: of a dataset, or drawn."""
    data, seed = loaded.spec.data, loaded.spec.seed
    if data.dataset is not None:
        report("data", 0.0)
        path = loaded.directory / data.dataset
        return labelled_rows(read_dataset_file(path), path, terrains)

    def drawn(stage: str, own: int, feasible: int, infeasible: int) -> Rows:
        return collect_rows(
            terrains,
            statement,
            feasible,
            infeasible,
            2 * seed + own,  # held-out terrains share none with the training
            lambda share: report(stage, share),
        )

    return LabelledRows(
        drawn("training", 1, data.training_feasible, data.training_infeasible),
        drawn("held-out", 2, data.validation_feasible, data.validation_infeasible),
    )


def _labelled(
    training: Rows, moved: Rows, terrains: TerrainDistribution, fit: EnvelopeFitSpec
) -> LabelledTerrains:
    """Training terrains with the points that were found, and those they were moved to."""
    known = np.stack([training.point, moved.point], axis=1)
    known[~training.feasible] = np.nan
    return LabelledTerrains(
        terrains.legs, training.terrain, fit.first_stage, known, _fingerprint(training)
    )


def clustered(moved: Rows, labels: FirstStageLabels, spec: EnvelopesSpec) -> EnvelopeSet:
    """Algorithm 2, its boxes grown until P1 calls enough training terrains feasible."""
    good, bad = training_points(moved)
    count = spec.fit.envelopes
    found = fit_clusters(good, bad, count, spec.fit.likelihood, spec.seed)
    fitted = [cluster.envelope for cluster in found]
    feasible = np.flatnonzero(moved.feasible)
    for growth in GROWTHS:
        envelopes = tuple(e.widen(growth) for e in fitted)
        if labels([envelopes], feasible)[0].mean() >= spec.fit.least_feasible:
            break
    return envelopes


def _searched(
    labels: FirstStageLabels,
    training: Rows,
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


def _fingerprint(rows: Rows) -> str:
    return hashlib.sha256(rows.terrain.tobytes() + rows.feasible.tobytes()).hexdigest()
