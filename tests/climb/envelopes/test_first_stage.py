"""P1 and P2: what the theorem of chapter 5.2.2 says of them, on terrains that can be looked at."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from climbplan.climb.envelopes.first_stage import FirstStage, Manner
from climbplan.climb.envelopes.first_stage_labels import LabelledTerrains, build_labeller
from climbplan.climb.envelopes.fit import (
    build_heuristic_envelope,
    contains_linear_point,
    contains_point,
    measure,
    prepare_stages,
    recentre_points,
)
from climbplan.climb.envelopes.rows import TerrainDataset, collect_rows
from climbplan.climb.envelopes.statement import PostureStatement, build_posture_statement
from climbplan.climb.envelopes.terrains import TerrainDistribution, select_distribution
from climbplan.learning.envelope_box import Envelope, compute_bounding_box
from climbplan.robots.model import Robot
from climbplan.schema.robots.source import load_robot

Case = tuple[TerrainDistribution, PostureStatement, TerrainDataset]


@pytest.fixture(scope="module")
def case() -> Case:
    terrains = select_distribution("wall3", Robot.from_spec(load_robot("silvia")))
    statement = build_posture_statement(terrains.legs)
    return terrains, statement, collect_rows(terrains, statement, 6, 6, seed=11)


def _boxes(rows: TerrainDataset) -> list[Envelope]:
    """Boxes of several sizes about the middle of feasible points."""
    whole = compute_bounding_box(rows.point[rows.feasible])
    return [whole.widen(share) for share in (-0.4, -0.2, 0.0, 0.5)]


def test_a_point_in_the_box_makes_the_first_stage_feasible(case: Case) -> None:
    _, statement, rows = case
    seen = set()
    for manner in get_args(Manner):
        prepared = prepare_stages(statement, rows, manner)
        for stage in prepared:
            for box in _boxes(rows):
                feasible = stage.solve(box.lower, box.upper) is not None
                if contains_point(stage, box):
                    assert feasible
                if not contains_linear_point(stage, box):
                    assert not feasible
                seen.add(feasible)
    assert seen == {True, False}


def test_tightening_only_takes_points_away(case: Case) -> None:
    _, statement, rows = case
    manners: tuple[Manner, ...] = ("published", "tightened", "propagated")
    called = np.array(
        [
            [
                [stage.solve(box.lower, box.upper) is not None for box in _boxes(rows)]
                for stage in prepare_stages(statement, rows, manner)
            ]
            for manner in manners
        ]
    )
    wide, tight, tightest = called
    assert (wide >= tight).all()
    assert (tight >= tightest).all()
    assert wide.sum() > tight.sum() or tight.sum() > tightest.sum()


def test_points_of_p_survive_propagation(case: Case) -> None:
    """A box drawn about a point of P keeps that point, whatever the rows cut off."""
    _, statement, rows = case
    for k, stage in enumerate(prepare_stages(statement, rows, "propagated")):
        if not rows.feasible[k]:
            continue
        point = rows.point[k]
        local = stage.relax(point - 0.15, point + 0.1)
        assert local is not None
        at = stage.factors
        assert (local.lower[at] <= point + 1e-7).all()
        assert (local.upper[at] >= point - 1e-7).all()
        width = (local.upper - local.lower)[at]
        assert (width <= 0.25 + 1e-9).all()


def test_labels_do_not_depend_on_the_number_of_processes(case: Case) -> None:
    terrains, statement, rows = case
    known = np.where(rows.feasible[:, None, None], rows.point, np.nan)[:, None]
    labelled = LabelledTerrains(terrains.legs, rows.terrain, "propagated", known, "case")
    prepared = prepare_stages(statement, rows, "propagated")
    sets = [(box,) for box in _boxes(rows)]
    chosen = np.array([0, 3, 5, 8, 11])
    alone = build_labeller(labelled, prepared)(sets, chosen)
    shared = build_labeller(labelled, prepared, jobs=2)(sets, chosen)
    np.testing.assert_array_equal(alone, shared)
    # The shortcut by known points changes nothing
    unknown = replace(labelled, known=np.full_like(known, np.nan))
    np.testing.assert_array_equal(alone, build_labeller(unknown, prepared)(sets, chosen))


def test_labels_and_points_of_rows(case: Case) -> None:
    """Feasible rows balance; infeasible ones balance forces and fail in the moments."""
    _, statement, rows = case
    down = np.array([0.0, 0.0, 1.0])
    for k in range(len(rows.terrain)):
        force = rows.point[k, :, 3:]
        np.testing.assert_allclose(force.sum(axis=0), down, atol=1e-6)
    assert rows.feasible.sum() == 6
    again = collect_rows(case[0], statement, 6, 6, seed=11)
    np.testing.assert_array_equal(again.terrain, rows.terrain)


def test_projection_keeps_toes_and_satisfies_everything(case: Case) -> None:
    _, statement, rows = case
    box = compute_bounding_box(rows.point[rows.feasible])
    projected = 0
    for k in np.flatnonzero(rows.feasible):
        stage = FirstStage.of(statement, rows.patches(int(k)))
        x = stage.solve(box.lower, box.upper, rows.point[k])
        assert x is not None
        found = stage.convex(x)
        if found is None:
            continue
        projected += 1
        toes = stage.factors[:, :3]
        np.testing.assert_allclose(found[toes], x[toes], atol=1e-9)
        assert stage.instance.violation(found) <= 1e-7
    assert projected >= 4


def test_recentred_points_stay_feasible_and_crowd(case: Case) -> None:
    _, statement, rows = case
    moved = recentre_points(rows, prepare_stages(statement, rows, "published"))
    good = rows.feasible
    spread = moved.point[good].std(axis=0).mean()
    assert spread < rows.point[good].std(axis=0).mean()
    np.testing.assert_array_equal(moved.point[~good], rows.point[~good])


def test_validation_counts(case: Case) -> None:
    """The whole space calls everything feasible; an empty corner of it nothing."""
    terrains, statement, rows = case
    prepared = prepare_stages(statement, rows, "published")
    ones = np.ones((3, 6))
    everything = measure((Envelope(-ones, ones),), rows, prepared).validation
    assert (everything.feasible, everything.nlp) == (1.0, 1.0)
    nothing = measure((Envelope(0.99 * ones, ones),), rows, prepared).validation
    assert (nothing.feasible, nothing.infeasible, nothing.nlp) == (0.0, 1.0, 0.0)
    expert = build_heuristic_envelope(terrains)
    assert (expert.lower <= expert.upper).all()
