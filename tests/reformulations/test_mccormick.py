"""Envelopes on grids: containment, bounds, encodings, counts, pinned pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bilinear_programs import bilinear, scanned

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program import Instance, Program
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.reformulations.disjunctions import BigM
from climbplan.reformulations.envelopes import build_halfspaces
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.reformulations.grids import Partition, build_code, each, pieces, together, uniform
from climbplan.reformulations.local_envelopes import LocalForm, LocalMcCormick
from climbplan.reformulations.mccormick import EnvelopedInstance, McCormick
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.result import SolverResult
from climbplan.solvers.scip.bilinear import solve_minlp_scip
from climbplan.solvers.tree.repair import repair_point

SEEDS = range(4)


def solved(form: EnvelopedInstance, gap: float = 1e-7) -> SolverResult:
    return solve_highs(BigM().apply(form.instance).instance, gap=gap)


def on_grid(pieces_each: int, encoding: str = "unary", squares: str = "envelope") -> McCormick:
    grids = {k: uniform(-1.0, 2.0, pieces_each) for k in (0, 1)}
    return McCormick.on(grids, encoding, squares)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", SEEDS)
def test_relaxations_bound_from_below_and_tighten(seed: int) -> None:
    instance = bilinear(seed)
    exact = solve_minlp_scip(instance, gap=1e-6)
    assert exact.objective is not None
    oracle = scanned(seed)
    assert exact.objective <= oracle + 1e-6
    assert oracle - exact.objective < 0.05 * max(1.0, abs(oracle))
    before = -np.inf
    for count in (1, 2, 4, 8):
        form = on_grid(count).apply(instance)
        assert form.relaxation
        result = solved(form)
        assert result.status == "optimal"
        assert result.objective is not None
        assert before - 1e-6 <= result.objective <= exact.objective + 1e-6
        before = result.objective
    assert exact.objective - before < 0.25 * max(1.0, abs(exact.objective))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("count", [3, 4, 5])
def test_unary_and_log2_agree(seed: int, count: int) -> None:
    instance = bilinear(seed)
    unary, log2 = (solved(on_grid(count, e).apply(instance)) for e in ("unary", "log2"))
    assert unary.objective == pytest.approx(log2.objective, abs=1e-6)


@pytest.mark.parametrize("squares", ["envelope", "secant"])
@pytest.mark.parametrize("encoding", ["unary", "log2"])
def test_lifted_points_are_feasible(encoding: str, squares: str) -> None:
    """Sampled containment: (x, x y) lies in the relaxation wherever x lies in a piece."""
    rng = np.random.default_rng(0)
    p = Program("free")
    x = p.continuous("x", (4,), -1.0, 2.0)
    p.between("products", x[:3] * x[1:], -9, 9)
    p.between("last", x[3:] * x[3:], -9, 9)
    p.between("square", x[:1] * x[:1], -9, 9)
    instance = p.instantiate()
    apart = np.array([[-1.0, -0.5], [0.0, 1.0], [0.7, 2.0]])  # a gap, an overlap
    form = McCormick.on({0: apart, 1: uniform(-1, 2, 4, 0.05)}, encoding, squares).apply(instance)
    assert not form.relaxation
    inside = 0
    for _ in range(300):
        point = rng.uniform(-1.0, 2.0, 4)
        if -0.5 < point[0] < 0.0:
            assert form.instance.violation(form.lift(point)) > 0
            continue
        inside += 1
        lifted = form.lift(point)
        sag = 0.0 if squares == "envelope" else 2.25  # of the widest chord, on [-1, 2]
        assert form.instance.violation(lifted) <= sag + 1e-9
        np.testing.assert_allclose(lifted[4:9], instance.products.values(point))
        np.testing.assert_array_equal(form.invert(lifted), point)
    assert inside > 200


def test_squares_without_a_grid_keep_the_parabola() -> None:
    low, high = np.array([-1.0, 0.5]), np.array([2.0, 1.5])
    for x in np.linspace(0.0, 1.0, 21):
        at = low + x * (high - low)
        planes = build_halfspaces(low, high, low, high, np.ones(2, bool), "envelope")
        value = (planes.a + planes.b) * at[:, None] + planes.c * (at**2)[:, None]
        assert (value <= planes.d + 1e-12).all()
        chord = build_halfspaces(low, high, low, high, np.ones(2, bool), "secant")
        w = (low + high) * at - low * high
        value = (chord.a + chord.b) * at[:, None] + chord.c * w[:, None]
        assert (value <= chord.d + 1e-12).all()
        assert (np.abs(value - chord.d).min(axis=1) < 1e-12).all()
        off = (chord.a + chord.b) * at[:, None] + chord.c * (w - 0.01)[:, None]
        assert (off > chord.d + 1e-3).any(axis=1).all()


def test_envelope_is_the_hull_of_its_corners() -> None:
    """Within the four planes, outside none: extreme w at a point equal those of the weights."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        ends = np.sort(rng.normal(size=(2, 2)), axis=1)
        planes = build_halfspaces(
            *(np.array([e]) for e in ends.ravel()), np.zeros(1, bool), "envelope"
        )
        x, y = rng.uniform(ends[:, 0], ends[:, 1])
        rest = planes.d - planes.a * x - planes.b * y
        least, most = (-rest[0, :2]).max(), rest[0, 2:].min()
        assert least - 1e-12 <= x * y <= most + 1e-12
        s, t = (np.array([x, y]) - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
        corner = {(a, b): ends[0, a] * ends[1, b] for a in (0, 1) for b in (0, 1)}
        both = [max(0.0, s + t - 1.0), min(s, t)]  # extreme weights of the upper corner
        values = [
            m * corner[1, 1]
            + (s - m) * corner[1, 0]
            + (t - m) * corner[0, 1]
            + (1 - s - t + m) * corner[0, 0]
            for m in both
        ]
        assert least == pytest.approx(min(values))
        assert most == pytest.approx(max(values))


def test_disconnected_pieces_exclude_the_gap() -> None:
    p = Program("gap")
    x = p.continuous("x", (2,), 0.0, 1.0)
    p.between("product", x[:1] * x[1:], 0.1, 1.0)
    p.minimise("near the middle", np.sum((x - 0.5) ** 2))
    instance = p.instantiate()
    grid = np.array([[0.0, 0.3], [0.8, 1.0], [0.9, 0.95]])
    for encoding in ("unary", "log2"):
        form = McCormick.on({0: grid}, encoding).apply(instance)
        result = solved(form)
        assert result.x is not None
        assert result.x[0] == pytest.approx(0.3, abs=1e-6)
        assert form.find_pieces(result.x)[0] == 0


def test_three_pieces_have_three_codes() -> None:
    np.testing.assert_array_equal(build_code(3), [[0, 0], [1, 0], [0, 1]])
    assert build_code(1).shape == (1, 0)
    counts = [Partition(np.array([0]), np.zeros((n, 1)), np.ones((n, 1))) for n in (1, 2, 3, 8, 9)]
    assert [c.count_binaries("log2") for c in counts] == [0, 1, 2, 3, 4]
    assert [c.count_binaries("unary") for c in counts] == [0, 2, 3, 8, 9]
    # Every integral point of the relaxation is one of the three pieces: the fourth code is empty.
    p = Program("three")
    x = p.continuous("x", (1,), 0.0, 3.0)
    p.between("square", x * x, 0.0, 9.0)
    form = McCormick.on({0: uniform(0.0, 3.0, 3)}, "log2").apply(p.instantiate())
    lower = form.instance.lower.copy()
    lower[form.bits[0]] = 1.0
    blocked = replace(form.instance, lower=lower)
    assert solve_highs(blocked).status == "infeasible"


def shelf_like() -> tuple[Instance, tuple[Partition, ...]]:
    """The products of the published bookshelf: 4 angles, 6 planes, 16 vertices of two numbers."""
    rng = np.random.default_rng(0)
    p = Program("shelf")
    turn = p.continuous("turn", (4, 2), [0.0, -1.0], [1.0, 1.0])
    plane = p.continuous("plane", (6, 2), -1.0, 1.0)
    vertex = p.continuous("vertex", (4, 4, 2), [-88.0, 0.0], [88.0, 110.0])
    side = p.continuous("side", (6,), -200.0, 200.0)
    p.binary("state", (18,))
    p.equal("rotation", turn[:, 0] ** 2 + turn[:, 1] ** 2 - 1)
    p.between("mixed", turn[:, 0] * turn[:, 1], -0.5, 0.5)
    p.equal("unit", plane[:, 0] ** 2 + plane[:, 1] ** 2 - 1)
    pairs = [(i, j) for i in range(4) for j in range(i + 1, 4)]
    for k, (i, j) in enumerate(pairs):
        for book, sign in ((i, 1.0), (j, -1.0)):
            distance = np.sum(vertex[book] * plane[k], axis=1) - side[k : k + 1]
            p.between(f"plane{k}_{book}", sign * distance, -np.inf, 1e-3)
    p.minimise("place", np.sum((vertex - rng.uniform(-50, 50, (4, 4, 2))) ** 2))
    instance = p.instantiate()
    knots = np.linspace(-np.pi / 2, np.pi / 2, 9)
    ends = np.stack([knots[:-1], knots[1:]], axis=1)
    cosine = np.cos(ends)
    low = np.stack([cosine.min(axis=1), np.sin(ends[:, 0])], axis=1) - 0.05
    high = np.stack([cosine.max(axis=1), np.sin(ends[:, 1])], axis=1) + 0.05
    v = p.variables
    start = v["turn"].start
    angles = tuple(together([start + 2 * b, start + 2 * b + 1], low, high, True) for b in range(4))
    planes = each(v["plane"], uniform(-1.0, 1.0, 8, 0.05))
    place = v["vertex"].start + np.arange(32).reshape(16, 2)
    across = each(place[:, 0].tolist(), uniform(-88.0, 88.0, 4, 1.5))
    along = each(place[:, 1].tolist(), uniform(0.0, 110.0, 4, 1.5))
    return instance, (*angles, *planes, *across, *along)


def test_published_count_of_binaries() -> None:
    instance, partitions = shelf_like()
    form = McCormick(partitions, "log2").form(instance).at(instance)
    assert form.instance.binary_count == 130
    assert form.relaxation
    published = McCormick(partitions, "log2", "secant").form(instance)
    assert not published.relaxation


def nearest(
    instance: Instance, form: EnvelopedInstance, x: Array
) -> tuple[SolverResult, SolverResult]:
    chosen = form.find_pieces(x)
    lifted = FixedIntegerForm.of(form.instance).at(form.build_integers(x, chosen), compact=True)
    mccormick = McCormick(form.partitions, "log2")
    local = LocalMcCormick.of_pieces(instance, mccormick, chosen).apply(instance).instance
    small = FixedIntegerForm.of(local).at(np.pad(x, (0, local.size - len(x))), compact=True)
    return solve_convex(lifted, "clarabel"), solve_convex(small, "clarabel")


@pytest.mark.parametrize("seed", SEEDS)
def test_pinned_pieces_are_the_local_envelope(seed: int) -> None:
    """The convex program of given pieces, through weights and directly on the box."""
    instance = bilinear(seed)
    grids = {k: uniform(-1.0, 2.0, 5) for k in (0, 1)}
    form = McCormick.on(grids, "log2").apply(instance)
    rng = np.random.default_rng(seed)
    agreed = 0
    for _ in range(12):
        x = rng.uniform(instance.lower, instance.upper)
        x[instance.integer] = rng.integers(0, 2, 2)
        lifted, small = nearest(instance, form, x)
        assert lifted.status == small.status
        if lifted.objective is not None:
            agreed += 1
            assert lifted.objective == pytest.approx(small.objective, abs=1e-6)
    exact = solve_minlp_scip(instance)
    assert exact.x is not None
    lifted, small = nearest(instance, form, exact.x)
    assert lifted.objective == pytest.approx(small.objective, abs=1e-6)
    assert lifted.objective is not None
    assert exact.objective is not None
    assert lifted.objective <= exact.objective + 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_inverted_points_come_closer_on_finer_grids(seed: int) -> None:
    instance = bilinear(seed)
    residuals = []
    for count in (1, 16):
        form = McCormick.on({k: uniform(-1, 2, count) for k in (0, 1)}, "log2").apply(instance)
        result = solved(form, gap=1e-4)
        assert result.x is not None
        residuals.append(instance.violation(form.invert(result.x)))
    assert residuals[1] <= 0.5 * residuals[0] + 1e-6
    x = repair_point(instance, form.invert(result.x))
    assert instance.violation(x) <= 1e-7


def test_mistakes_are_named() -> None:
    instance = bilinear(0)
    with pytest.raises(UsageError, match="two partitions"):
        McCormick((*each([0], uniform(0, 1, 2)), *each([0], uniform(0, 1, 2))))
    with pytest.raises(UsageError, match="too early"):
        each([0], [[1.0, 0.0]])
    with pytest.raises(UsageError, match="increasing"):
        pieces([0.0, 0.0, 1.0])
    assert not McCormick.on({99: uniform(0, 1, 2)}).accepts(instance)
    p = Program("open")
    x = p.continuous("x", (2,))
    p.between("product", x[:1] * x[1:], 0.0, 1.0)
    with pytest.raises(UsageError, match="open: variable 0 is a factor"):
        McCormick().apply(p.instantiate())


def test_local_form_changes_numbers_only() -> None:
    """One form for many boxes and pins agrees with building each from scratch."""
    instance = bilinear(3)
    rng = np.random.default_rng(0)
    pins = FixedIntegerForm.of(instance)
    first = pins.at(np.zeros(instance.size))
    form = LocalForm.of(first)
    for _ in range(6):
        x = rng.uniform(instance.lower, instance.upper)
        x[instance.integer] = rng.integers(0, 2, 2)
        low, high = np.maximum(x - 0.4, instance.lower), np.minimum(x + 0.4, instance.upper)
        pinned = pins.at(x)
        reused = form.at(ElementwiseRange(low, high), pinned)
        rebuilt = LocalMcCormick(low, high).apply(pinned).instance
        assert abs(reused.A - rebuilt.A).max() == 0.0
        for name in ("lower", "upper", "row_lower", "row_upper"):
            np.testing.assert_array_equal(vars(reused)[name], vars(rebuilt)[name])
        # Any point of the box with its exact products satisfies the envelopes.
        y = rng.uniform(low, high)
        y[instance.integer] = x[instance.integer]
        y = np.clip(y, reused.lower[: instance.size], reused.upper[: instance.size])
        lifted = np.concatenate([y, instance.products.values(y)])
        rows = slice(first.A.shape[0], None)
        assert (reused.A[rows] @ lifted <= reused.row_upper[rows] + 1e-12).all()
