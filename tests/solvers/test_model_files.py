"""Model files of other solvers: what is read is what was stated, mistakes are named by line."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

import climbplan
from benchmarks.engine.qplib import FILE, QplibRow, run_qplib
from benchmarks.kept_rows import read_rows
from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.solvers.model_file import save_model
from climbplan.solvers.model_files.reading import problem_from_file
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound

MPS = """\
* a comment
NAME          small
OBJSENSE
    MAX
ROWS
 N  cost
 L  ball
 G  low
 E  same
COLUMNS
 x  cost  1.0  low  1.0
 y  cost  2.0  low  1.0
    M1  'MARKER'  'INTORG'
 k  cost  -1.0  same  1.0
 z  cost  0.5
    M2  'MARKER'  'INTEND'
 s  same  -1.0
RHS
 RHS  cost  -3.0  ball  4.0
 RHS  low   1.0
RANGES
 RNG  low  4.0
BOUNDS
 FR BND x
 LO BND y -2
 UP BND k 5
 MI BND s
QUADOBJ
 x x -2.0
QCMATRIX ball
 x x 1.0
 x y 0.5
 y x 0.5
 y y 1.0
ENDATA
"""

QPLIB = """\
! a comment
SMALL           # name
QGQ
maximize
3               # variables
2               # rows
2               # of P
1 1 -2.0
2 3 1.0
0.0
1
3 0.5
-3.0            # constant
1               # of H
2 1 2 1.0
3               # of A
1 1 1.0
1 2 1.0
2 3 -1.0
1.0E19
-1.0E20
1
2 0.0
4.0
1
2 0.0
-1.0
0
2.0
0
0
1
3 2
0.0
0
0.0
0
0.0
0
1
1 height
0
"""

BOX = """\
BOX
LBN
minimize
2
1.0
0
0.0
1e20
0.0
0
0.0
0
0
0
"""


def _write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_mps(tmp_path: Path) -> None:
    problem = problem_from_file(_write(tmp_path, "small.mps", MPS))
    instance = problem.instance({})
    assert list(problem.program.variables) == ["x", "y", "k", "z", "s"]
    assert instance.lower.tolist() == [-np.inf, -2.0, 0.0, 0.0, -np.inf]
    assert instance.upper.tolist() == [np.inf, np.inf, 5.0, 1.0, np.inf]
    assert instance.integer.tolist() == [False, False, True, True, False]
    assert (instance.row_lower.tolist(), instance.row_upper.tolist()) == ([1.0, 0.0], [5.0, 0.0])
    x = np.array([1.0, 0.5, 2.0, 1.0, 2.0])
    assert -instance.objective(x) == pytest.approx(1.0 + 1.0 - 2.0 + 0.5 + 3.0 - 1.0)
    assert [len(balls.radius) for balls in instance.balls] == [1]
    on_boundary = np.array([1.0, (-1.0 + np.sqrt(13.0)) / 2.0])  # x^2 + x y + y^2 = 4
    point = np.array([*on_boundary, 0.0, 0.0, 0.0])
    assert instance.balls[0].excess(point)[0] == pytest.approx(0.0, abs=1e-12)
    assert instance.balls[0].excess(1.1 * point)[0] > 0.0


def test_qplib(tmp_path: Path) -> None:
    problem = problem_from_file(_write(tmp_path, "small.qplib", QPLIB))
    instance = problem.instance({})
    assert list(problem.program.variables) == ["height", "x2", "x3", "cost"]
    assert instance.integer.tolist() == [False, False, True, False]
    assert instance.upper.tolist()[:3] == [2.0, 2.0, 1.0]
    assert "products" in instance.features
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.uniform(-1.0, 2.0, 3)
        x[2] = rng.integers(0, 2)
        value = -(x[0] ** 2) + 0.5 * x[1] * x[2] + 0.5 * x[2] - 3.0
        point = np.append(x, -value)
        worst = max(0.0, x[0] + x[1] - 4.0, abs(0.5 * x[0] * x[1] - x[2]))
        assert instance.objective(point) == pytest.approx(-value)
        assert instance.violation(point) == pytest.approx(worst)


def test_a_qplib_box(tmp_path: Path) -> None:
    instance = problem_from_file(_write(tmp_path, "box.qplib", BOX)).instance({})
    assert instance.integer.all()
    assert (instance.lower.tolist(), instance.upper.tolist()) == ([0.0, 0.0], [1.0, 1.0])
    assert instance.q.tolist() == [1.0, 1.0]


def test_squares_of_binaries_make_a_cost_convex(tmp_path: Path) -> None:
    text = BOX.replace("LBN", "QBN").replace("\n2\n1.0", "\n2\n1\n2 1 -1.0\n1.0")
    instance = problem_from_file(_write(tmp_path, "box.qplib", text)).instance({})
    assert not instance.products.count
    for x in np.ndindex(2, 2):
        assert instance.objective(np.array(x, float)) == pytest.approx(sum(x) - x[0] * x[1])
    assert np.linalg.eigvalsh(instance.P.toarray()).min() >= 0.0


def _state_program() -> Instance:
    p = Program("walk")
    x = p.continuous("x", (3,), -2.0, 3.0)
    z = p.binary("z", (2,))
    p.between("rows", np.array([x[0] + 2.0 * z[0], x[1] - z[1]]), [-1.0, 0.0], [1.0, 0.0])
    p.ball("ball", np.array([[x[0] - 0.2, x[1] - 0.1]]), np.array([1.4]))
    p.minimise("cost", np.sum((x - 0.5) ** 2) + 0.3 * z[0] + 2.0)
    return p.instantiate()


@pytest.mark.parametrize("suffix", [".mps", ".nl"])
def test_what_is_saved_is_read(tmp_path: Path, suffix: str) -> None:
    stated, path = _state_program(), tmp_path / f"walk{suffix}"
    save_model(stated, path)
    instance = problem_from_file(path).instance({})
    assert not instance.products.count
    expected, found = solve_branch_and_bound(stated), solve_branch_and_bound(instance)
    assert found.status == expected.status == "optimal"
    assert found.objective == pytest.approx(expected.objective, abs=1e-4)


def test_lp_with_quadratic_cost(tmp_path: Path) -> None:
    text = (
        "Maximize\n obj: x + 2 y - [ x ^ 2 + y ^ 2 ] / 2\nSubject To\n c1: x + y <= 3\n"
        "Bounds\n x <= 4\n y <= 4\nGeneral\n y\nEnd\n"
    )
    problem, theta = climbplan.problem_from_spec(_write(tmp_path, "small.lp", text))
    solution = climbplan.solve(problem, theta)
    assert solution.status == "optimal"
    assert solution.objective == pytest.approx(-2.5, abs=1e-3)
    assert solution["y"][0] == pytest.approx(2.0)


def test_a_smooth_nl_file(tmp_path: Path) -> None:
    text = (
        "g3 1 1 0\n 1 1 1 0 0\n 1 1\n 0 0\n 1 1 1\n 0 0 0 1\n 0 0 0 0 0\n 1 1\n 0 0\n 0 0 0 0 0\n"
        "C0\no44\nv0\nO0 0\no41\nv0\nr\n1 2.0\nb\n0 -1 3\nk0\nJ0 1\n0 0\nG0 1\n0 0\n"
    )
    problem = problem_from_file(_write(tmp_path, "smooth.nl", text))
    assert "smooth" in problem.instance({}).features


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("x  cost  1.0", "x  cost  one", r"expected a number, got 'one'"),
        ("y  cost  2.0  low", "y  cost  2.0  lo", ".*ROWS states, got 'lo'"),
        (" G  low", " Q  low", "expected N, L, G or E"),
        ("UP BND k 5", "UB BND k 5", r"expected a bound \(UP"),
        ("UP BND k 5", "UP BND q 5", ".*COLUMNS states, got 'q'"),
        ("QUADOBJ", "SOS", "expected one of the sections"),
        ("low   1.0", "low   nan", "expected a number"),
        ("LO BND y -2", "FX y", "expected a bound"),
        ("RNG  low  4.0", "RNG", "expected names with a number"),
        (" s  same  -1.0", " s  same  -1.0 same 2", "expected one entry"),
    ],
)
def test_mistakes_of_mps_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    line = MPS[: MPS.index(old)].count("\n") + 1
    with pytest.raises(UsageError, match=rf"small\.mps:{line}: {message}"):
        problem_from_file(_write(tmp_path, "small.mps", MPS.replace(old, new)))


def test_an_integer_without_bounds_and_a_file_without_an_end(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="integer variable 'k' has no bounds"):
        problem_from_file(_write(tmp_path, "a.mps", MPS.replace("UP BND k 5", "PL BND k")))
    with pytest.raises(UsageError, match="expected ENDATA, got 'the end of the file'"):
        problem_from_file(_write(tmp_path, "a.mps", MPS.replace("ENDATA\n", "")))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("QGQ", "QXQ", "small.qplib:3: expected a class of three letters"),
        ("maximize", "enlarge", "small.qplib:4: expected minimize or maximize, got 'enlarge'"),
        ("3               # variables", "3000000", "small.qplib:5: .*from 1 to 20000"),
        ("2               # rows", "-2", "small.qplib:6: .*from 0 to"),
        ("2               # of P", "7", "small.qplib:7: expected the number of entries of P"),
        ("1 1 -2.0", "1 4 -2.0", "small.qplib:8: expected an index of P from 1 to 3, got '4'"),
        ("1 1 -2.0", "1 1 x", "small.qplib:8: expected a number of P, got 'x'"),
        ("2 1 2 1.0", "2 1 2", "small.qplib:15: expected H"),
        ("3 2\n0.0", "3 7\n0.0", "kinds of variables 0, 1 or 2, got '7'"),
        ("1 height\n0\n", "1 height\n", "small.qplib:41: the file ends"),
        ("1 height", "1 x2", "expected names of variables that differ"),
    ],
)
def test_mistakes_of_qplib_files(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in QPLIB
    with pytest.raises(UsageError, match=message):
        problem_from_file(_write(tmp_path, "small.qplib", QPLIB.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.lp", "Minimize\n obj: x\nSubject To\n c1: x >=\n c2: x\nEnd\n", r"a\.lp:\d: "),
        ("a.lp", "Minimize\n obj: x\nSubject To\n c: [ x^2 ] <= 1\nEnd\n", "write the model as"),
        ("a.nl", "g3 1 1 0\n 2 1\n", r"a\.nl:\d+: "),
        ("a.nl", "b3 1 1 0\n 2 1\n", r"a\.nl:1: expected an \.nl file in text form"),
        ("a.nl", "g3 1 1 0\n 2000000000 1 1 0 0\n", r"a\.nl:2: 2000000000 variables"),
        ("a.mps", "", r"a\.mps:0: expected ENDATA"),
        ("a.cip", "", "expected a model file"),
    ],
)
def test_mistakes_of_other_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        problem_from_file(_write(tmp_path, name, text))


def test_the_benchmark_keeps_its_rows(tmp_path: Path) -> None:
    out, stream = tmp_path / "out", io.StringIO()
    run_qplib(True, stream, tmp_path, out, None)
    assert "no QPLIB files of this subset" in stream.getvalue()
    costs = BOX.replace("\n2\n1.0\n", "\n2\n-1.0\n")  # an optimum of 0 has no relative gap
    _write(tmp_path, "QPLIB_3980.qplib", costs)
    run_qplib(True, stream, tmp_path, out, None)
    rows = read_rows(out / FILE, QplibRow)
    assert [(row.solver, row.status) for row in rows] == [
        ("climbplan", "optimal"),
        ("scip", "optimal"),
        ("highs", "optimal"),
    ]
    before = (out / FILE).read_text()
    run_qplib(True, stream, tmp_path, out, None)
    assert (out / FILE).read_text() == before


def test_a_file_that_is_missing(tmp_path: Path) -> None:
    for suffix in (".mps", ".lp", ".nl", ".qplib"):
        with pytest.raises(UsageError, match="none"):
            problem_from_file(tmp_path / f"none{suffix}")
