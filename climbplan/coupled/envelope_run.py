"""One run of `fit-envelopes`: labelled terrains, envelopes by each method, the validation table."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from climbplan.coupled.envelope_fit import (
    Conditions,
    Validation,
    conditions,
    heuristic,
    labels_of,
    recentred,
    stages,
    training_points,
    validate,
)
from climbplan.coupled.rows import Rows, collect_rows
from climbplan.coupled.statement import posture_statement
from climbplan.coupled.terrains import distribution
from climbplan.learning.envelope_box import Envelope, FirstStageLabels
from climbplan.learning.envelope_clustering import fit_clusters
from climbplan.learning.envelope_genetic import GeneticOptions, GeneticResult, evolve
from climbplan.program.polytope import Array
from climbplan.robots.model import Robot
from climbplan.spec.envelopes import EnvelopeFitSpec, EnvelopesSpec

Report = Callable[[str, float], None]
GROWTHS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12)  # of each side of the box, in widths
_VALIDATION_SEED = 1  # added to the spec's: held-out terrains share none with the training


@dataclass(frozen=True)
class FittedEnvelope:
    """One envelope with what was measured of it on held-out terrains."""

    method: str
    envelope: Envelope
    validation: Validation
    conditions: Conditions


@dataclass(frozen=True)
class EnvelopeRun:
    """All envelopes of one run."""

    limb_names: tuple[str, ...]
    fitted: tuple[FittedEnvelope, ...]
    fitness: Array  # (G, 3) mean, spread and best of each generation, none without the search
    training: Rows
    held_out: Rows
    fingerprint: str  # sha256 of the training terrains and labels
    timings: dict[str, float]  # [s]


def fit_envelopes(spec: EnvelopesSpec, robot: Robot, report: Report) -> EnvelopeRun:
    """Draw, fit and validate."""
    given = spec.terrain
    terrains = replace(
        distribution(given.distribution, robot),
        tilt=float(np.deg2rad(given.tilt_deg)),
        jitter=given.jitter,
        half_size=given.half_size,
    )
    statement = posture_statement(terrains.legs)
    seconds: dict[str, float] = {}
    begin = time.perf_counter()

    def done(stage: str) -> None:
        nonlocal begin
        seconds[stage] = time.perf_counter() - begin
        begin = time.perf_counter()

    data = spec.data
    training = collect_rows(
        terrains,
        statement,
        data.training_feasible,
        data.training_infeasible,
        2 * spec.seed,
        lambda share: report("training", share),
    )
    held_out = collect_rows(
        terrains,
        statement,
        data.validation_feasible,
        data.validation_infeasible,
        2 * spec.seed + _VALIDATION_SEED,
        lambda share: report("held-out", share),
    )
    done("data")
    prepared = stages(statement, training, spec.fit.first_stage)
    labels = labels_of(prepared)
    found: dict[str, Envelope] = {}
    wanted = spec.fit.method
    if wanted in ("all", "heuristic", "genetic"):
        found["heuristic"] = heuristic(terrains)
    fitness = np.zeros((0, 3))
    if wanted in ("all", "clustering", "genetic"):
        moved = recentred(training, prepared, lambda share: report("recentring", share))
        found["clustering"] = clustered(moved, labels, spec)
        done("clustering")
    if wanted in ("all", "genetic"):
        searched = _searched(labels, training, list(found.values()), spec.fit, spec.seed, report)
        found["genetic"] = searched.envelope
        fitness = np.stack(
            [searched.fitness_mean, searched.fitness_spread, searched.fitness_best], axis=1
        )
        done("genetic")
    checked = stages(statement, held_out, spec.fit.first_stage)
    fitted: list[FittedEnvelope] = []
    for method, envelope in found.items():
        if wanted not in ("all", method):
            continue
        report("validation", len(fitted) / len(found))
        fitted.append(
            FittedEnvelope(
                method,
                envelope,
                validate((envelope,), held_out, checked),
                conditions(envelope, held_out, checked),
            )
        )
    done("validation")
    return EnvelopeRun(
        terrains.legs.names,
        tuple(fitted),
        fitness,
        training,
        held_out,
        _fingerprint(training),
        seconds,
    )


def clustered(moved: Rows, labels: FirstStageLabels, spec: EnvelopesSpec) -> Envelope:
    """Algorithm 2, its box grown until P1 calls enough training terrains feasible."""
    good, bad = training_points(moved)
    fitted = fit_clusters(good, bad, 1, spec.fit.likelihood, spec.seed)[0].envelope
    feasible = np.flatnonzero(moved.feasible)
    for growth in GROWTHS:
        envelope = fitted.grown(growth)
        if labels(envelope, feasible).mean() >= spec.fit.least_feasible:
            break
    return envelope


def _searched(
    labels: FirstStageLabels,
    training: Rows,
    first: list[Envelope],
    fit: EnvelopeFitSpec,
    seed: int,
    report: Report,
) -> GeneticResult:
    options = GeneticOptions(
        population=fit.genetic.population,
        generations=fit.genetic.generations,
        terrains=fit.genetic.terrains,
        delta=fit.genetic.delta,
    )
    return evolve(
        labels, training.feasible, first, options, seed, lambda share: report("genetic", share)
    )


def _fingerprint(rows: Rows) -> str:
    return hashlib.sha256(rows.terrain.tobytes() + rows.feasible.tobytes()).hexdigest()
