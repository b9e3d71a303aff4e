"""The validation table and the theorem's conditions on a problem that can be enumerated.

One limb, of which two numbers are free: p (toe x) and f (force z). P(theta): p f = t with p + f in
[s, s + d]; theta = (t, s, d). All of its sets are looked at point by point on a grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from climbplan.climb.envelopes.first_stage import FirstStage
from climbplan.climb.envelopes.fit import measure
from climbplan.climb.envelopes.rows import TerrainDataset
from climbplan.learning.envelope_box import Envelope
from climbplan.program import Program
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.local_envelopes import LocalForm

GRID = np.linspace(-1, 1, 801)
P, F = np.meshgrid(GRID, GRID, indexing="ij")
# (t, s, d): with the box [0.2, 0.8]^2 below
THETA = [
    (0.25, 0.98, 0.04),  # feasible in the box, near (0.5, 0.5)
    (0.30, 1.10, 0.40),  # feasible in the box, a broad band
    (-0.6, 0.10, 0.20),  # feasible, but p and f have opposite signs: not in the box
    (0.18, 0.98, 0.04),  # feasible near (0.24, 0.76): a corner of the box
    (0.60, 0.40, 0.20),  # infeasible, and P1 sees it: p f <= 0.09 there
    (0.31, 0.95, 0.10),  # infeasible by little: (p + f)^2 < 4 p f, P1 is too loose for it
    (-0.9, -0.05, 0.02),  # feasible, outside
    (0.50, -0.20, 0.10),  # infeasible, and the linear part misses the box too
]
BOX = (0.2, 0.8)
ROUNDING = 1e-9
DECISIVE = 4e-3  # a grid point that misses p f = t by less counts as a solution


@dataclass(frozen=True)
class Enumerated:
    """What the grid says of one theta."""

    feasible: bool
    in_box: bool  # a point of P is in the box: condition 1
    linear_in_box: bool  # a point of P without p f = t is: condition 2 fails
    first_stage: bool  # P1 has a point


def _enumerated(t: float, s: float, d: float) -> Enumerated:
    off = np.clip(P + F, s, s + d) - (P + F)
    band = np.abs(off) <= ROUNDING
    box = np.abs(np.clip(P, *BOX) - P) + np.abs(np.clip(F, *BOX) - F) <= ROUNDING
    solves = band & (np.abs(P * F - t) <= DECISIVE)
    low, high = BOX
    under = np.maximum(low * P + low * F - low * low, high * P + high * F - high * high)
    over = low * P + high * F - low * high, high * P + low * F - low * high
    relaxed = (under <= t + DECISIVE) & (np.minimum(*over) >= t - DECISIVE)
    return Enumerated(
        bool(solves.any()),
        bool((solves & box).any()),
        bool((band & box).any()),
        bool((band & box & relaxed).any()),
    )


def _stage(t: float, s: float, d: float) -> FirstStage:
    p = Program("two factors")
    free = np.array([[1.0, 0.0, 0.0]])
    toe = p.continuous("toe", (1, 3), -free, free)
    f = p.continuous("force", (1, 3), -free[:, ::-1], free[:, ::-1])
    p.equal("product", toe[0, 0] * f[0, 2] - t)
    p.between("band", toe[0, 0] + f[0, 2], s, s + d)
    instance = p.instantiate()
    columns = np.arange(6)[None]
    return FirstStage(
        instance, LocalForm.of(instance), columns, ElementwiseRange(instance.lower, instance.upper)
    )


def _envelope() -> Envelope:
    """The box of p and f; the other four factors are zero anyway."""
    low, high = np.full((1, 6), -1.0), np.full((1, 6), 1.0)
    low[0, [0, 5]], high[0, [0, 5]] = BOX
    return Envelope(low, high)


@pytest.fixture(scope="module")
def table() -> tuple[list[Enumerated], TerrainDataset, list[FirstStage]]:
    known = [_enumerated(*theta) for theta in THETA]
    feasible = np.array([k.feasible for k in known])
    none = np.zeros((len(THETA), 1, 6))
    rows = TerrainDataset(np.array(THETA), feasible, none, len(THETA), 0, 0)
    return known, rows, [_stage(*theta) for theta in THETA]


def test_grid_tells_what_the_comments_say(
    table: tuple[list[Enumerated], TerrainDataset, list[FirstStage]],
) -> None:
    known = table[0]
    assert [k.feasible for k in known] == [True, True, True, True, False, False, True, False]
    assert [k.in_box for k in known] == [True, True, False, True, False, False, False, False]


def test_table_is_the_enumerated_one(
    table: tuple[list[Enumerated], TerrainDataset, list[FirstStage]],
) -> None:
    known, rows, stages = table
    found = measure((_envelope(),), rows, stages).validation
    good = [k for k in known if k.feasible]
    bad = [k for k in known if not k.feasible]
    assert found.feasible == np.mean([k.first_stage for k in good]) == 0.6
    assert found.infeasible == np.mean([not k.first_stage for k in bad]) == pytest.approx(2 / 3)
    assert found.nlp == found.feasible  # from every point of P1 there is a way to P
    assert 0 < found.convex < found.nlp  # the narrow band at the middle of the box leaves no room
    assert (found.feasible_count, found.infeasible_count) == (5, 3)


def test_conditions_are_the_enumerated_ones(
    table: tuple[list[Enumerated], TerrainDataset, list[FirstStage]],
) -> None:
    known, rows, stages = table
    found = measure((_envelope(),), rows, stages).conditions
    assert found.meets == np.mean([k.in_box for k in known if k.feasible]) == 0.6
    shut = [not k.linear_in_box for k in known if not k.feasible]
    assert found.excludes == np.mean(shut) == pytest.approx(1 / 3)
    assert found.projects == pytest.approx(
        measure((_envelope(),), rows, stages).validation.convex / found.meets
    )


def test_theorem_holds_terrain_by_terrain(
    table: tuple[list[Enumerated], TerrainDataset, list[FirstStage]],
) -> None:
    """(1) makes P1 feasible, (2) makes it infeasible; neither is needed."""
    known, _, stages = table
    box = _envelope()
    for one, stage in zip(known, stages, strict=True):
        called = stage.solve(box.lower, box.upper) is not None
        assert called == one.first_stage
        if one.in_box:
            assert called
        if not one.linear_in_box:
            assert not called


def test_several_boxes_are_a_union(
    table: tuple[list[Enumerated], TerrainDataset, list[FirstStage]],
) -> None:
    """A second box, where p and f have opposite signs, meets the other feasible sets."""
    _, rows, stages = table
    low, high = np.full((1, 6), -1.0), np.full((1, 6), 1.0)
    high[0, 5] = -0.7
    low[0, 0] = 0.7
    both = (_envelope(), Envelope(low, high))
    found = measure(both, rows, stages).validation
    assert found.feasible == 1.0
    assert measure(both, rows, stages).conditions.meets == 1.0
