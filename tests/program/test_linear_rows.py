"""Rows of numbers in named blocks: what is built, and what is said of a point."""

from __future__ import annotations

import numpy as np
import pytest

from climbplan.program.linear_rows import LinearRows
from climbplan.solvers.highs.model import build_rows_model, create_highs, run_highs


@pytest.fixture
def shed() -> LinearRows:
    """Three loads on two beams, each whole or not; what is carried is to be as much as can be."""
    rows = LinearRows({"beam.limit": "N"})
    load = rows.columns((2, 3), 0.0, 10.0)
    on = rows.binaries((2,))
    for column in load.ravel():
        rows.cost[column] = -1.0
    for beam, most in enumerate((12.0, 15.0)):
        rows.at_most("beam.limit", [(c, 1) for c in load[beam]], most)
        rows.within(
            "beam.balance", [(load[beam, 0], 1), (load[beam, 2], -1)], 0.5, [(on[beam], 1)], 2
        )
    rows.equal("crew", [(on[0], 1), (on[1], 1)], 1)
    return rows


def test_rows_are_what_was_stated(shed: LinearRows) -> None:
    matrix = shed.matrix().toarray()
    assert matrix.shape == (7, 8)
    assert len(shed) == 7
    np.testing.assert_array_equal(matrix[0], [1, 1, 1, 0, 0, 0, 0, 0])
    # |a - c| <= 0.5 + 2 on
    np.testing.assert_array_equal(matrix[1], [1, 0, -1, 0, 0, 0, -2, 0])
    np.testing.assert_array_equal(matrix[2], [1, 0, -1, 0, 0, 0, 2, 0])
    np.testing.assert_array_equal(shed.row_lower[:3], [-np.inf, -np.inf, -0.5])
    np.testing.assert_array_equal(shed.row_upper[:3], [12, 0.5, np.inf])
    assert shed.names.names == ("beam.limit", "beam.balance", "crew")
    assert [shed.names.names[k] for k in shed.names.block] == [
        *("beam.limit", "beam.balance", "beam.balance") * 2,
        "crew",
    ]


def test_many_rows_at_once_are_the_same_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.permutation(6)[:4], rng.integers(0, 6, 4)
    weights, low = rng.normal(size=4), rng.normal(size=4)
    together, apart = LinearRows(), LinearRows()
    for rows in (together, apart):
        rows.columns((6,), -1.0, 1.0)
        rows.equal("before", [(0, 1.0)])
    block = together.block("sum", ((first, weights), (second, -2.0)), low, 3.0)
    for i, j, w, bound in zip(first, second, weights, low, strict=True):
        apart.row("sum", [(i, w), (j, -2.0)], bound, 3.0)
    np.testing.assert_array_equal(together.matrix().toarray(), apart.matrix().toarray())
    np.testing.assert_array_equal(together.row_lower, apart.row_lower)
    np.testing.assert_array_equal(together.row_upper, apart.row_upper)
    assert together.names.names == apart.names.names
    np.testing.assert_array_equal(together.names.block, apart.names.block)
    _, column, value = together.entries()
    assert (block.rows, block.values) == (slice(1, 5), slice(1, 9))
    np.testing.assert_array_equal(column[block.values].reshape(4, 2)[:, 1], second)
    np.testing.assert_array_equal(value[block.values].reshape(4, 2)[:, 0], weights)


def test_without_upper_ends_rows_are_equations() -> None:
    rows = LinearRows()
    x = rows.columns((2,), -1.0, 1.0)
    rows.block("pinned", ((x, 1.0),), np.array([0.5, -0.5]))
    np.testing.assert_array_equal(rows.row_lower, rows.row_upper)


def test_a_point_is_judged_block_by_block(shed: LinearRows) -> None:
    x = np.array([4.0, 4.0, 4.0, 5.0, 5.0, 9.0, 0.0, 0.7])
    said = {block.name: block for block in shed.residuals(x)}
    assert said["beam.limit"].residual == pytest.approx(4.0)
    assert said["beam.limit"].unit == "N"
    assert said["beam.limit"].index == (1,)  # of the second beam
    assert said["beam.balance"].residual == pytest.approx(4.0 - 0.5 - 1.4)
    assert said["beam.balance"].index == (3,)
    assert said["crew"].residual == pytest.approx(0.3)
    assert said["integrality"].residual == pytest.approx(0.3)
    assert said["integrality"].index == (7,)
    assert said["bounds"].residual == 0.0
    assert str(shed.worst(x)) == "beam.limit off by 4 N"
    x[0] = -7.1
    assert str(shed.worst(x)) == "beam.balance off by 11"
    assert {b.name: b for b in shed.residuals(x)}["bounds"].index == (0,)


def test_what_highs_answers_holds(shed: LinearRows) -> None:
    solver = create_highs()
    solver.passModel(build_rows_model(shed))
    run_highs(solver)
    x = np.array(solver.getSolution().col_value)
    assert shed.worst(x).residual < 1e-9
    assert x[6:].sum() == pytest.approx(1.0)
    relaxed = build_rows_model(shed, relaxed=True)
    assert len(relaxed.integrality_) == 0
