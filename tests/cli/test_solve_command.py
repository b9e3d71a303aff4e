"""`climbplan solve`: the shipped cart-pole by every method, and what users get wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import RunCommand

SPECS = Path(__file__).parents[2] / "specs"
SPEC, STATEMENT = SPECS / "cart_pole.yaml", SPECS / "cart_pole.py"
DAMPED, SPRINGS = f"{STATEMENT}:problem", f"{STATEMENT}:springs"

POND = """
from climbplan.program import Problem, Program

def problem():
    p = Program("pond")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (2,), -4.0, 4.0, unit="m")
    wet = p.binary("wet", (1,))
    p.between("bank", x[0], 1.0, 3.0, unit="m")
    p.when("rope", wet[0], x[1], lower=0.5, unit="m")
    p.when("dry", wet[0], x[1], upper=0.0, unit="m", value=False)
    p.minimise("distance", (x[0] - goal[0]) ** 2 + (x[1] - goal[1]) ** 2 + wet[0])
    return Problem("pond", p, sample=lambda rng: {"goal": rng.uniform(0, 3, 2)})

def broken():
    return 1 / 0

def misstated():
    p = Program("twice")
    p.continuous("x", (1,))
    p.continuous("x", (1,))

def cornered():
    p = Program("cornered")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (2,), -4.0, 4.0)
    p.between("east", x[0], 3.0, 4.0)
    p.between("north", x[1], 0.0, 1.0)
    p.ball("tether", x, 2.0)
    p.minimise("cost", x[0] ** 2)
    return Problem("cornered", p)

number = 3
"""


@pytest.fixture
def pond(workplace: Path) -> Path:
    (workplace / "own_pond.py").write_text(POND)
    (workplace / "pond.yaml").write_text("kind: program\ntheta:\n  goal: [2, 2]\n")
    return workplace


def test_a_statement_of_at_most_120_lines() -> None:
    assert len(STATEMENT.read_text().splitlines()) <= 120


def test_the_shipped_line_and_its_verification(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("solve", str(SPEC), "--problem", DAMPED)
    assert (done.code, done.out) == (0, "outputs/cart_pole/plan.h5\n"), done.err
    assert "passed" in done.err
    made = {path.name for path in (workplace / "outputs" / "cart_pole").iterdir()}
    assert made == {"plan.h5", "report.json"}
    report = json.loads((workplace / "outputs/cart_pole/report.json").read_text())
    names = {check["name"] for check in report["verification"]["checks"]}
    assert {"dynamics.step", "wall.law", "wall.free", "integrality.touch"} <= names
    assert report["verified"] is True
    assert np.shape(report["results"][0]["variables"]["state"]) == (11, 4)
    whole = run_command("verify", "outputs/cart_pole", "--problem", DAMPED)
    assert whole.code == 0
    assert "wall.law" in whole.out
    bare = run_command("verify", "outputs/cart_pole/plan.h5")
    assert bare.code == 2
    assert "file.integrality.touch" in bare.out
    assert "need its statement: add --problem" in bare.err
    page = run_command("report", "outputs/cart_pole")
    assert page.code == 2
    assert "report.json is beside them" in page.err
    with h5py.File("outputs/cart_pole/plan.h5", "r+") as file:
        file["x"][0, 5] += 0.01
    assert run_command("verify", "outputs/cart_pole", "--problem", DAMPED).code == 5


@pytest.mark.slow
def test_every_published_method_from_the_command_line(
    run_command: RunCommand, workplace: Path
) -> None:
    """A library of drawn problems, then MICP, MPCC, pinned and k-NN on one that is not in it."""
    base = ("solve", str(SPEC), "--problem", DAMPED)
    drawn = ("-s", "theta=null", "-s", "sample.count=40", "--method", "mpcc", "--seed", "7")
    library = run_command(*base, *drawn, "--out", "library")
    assert library.code == 0, library.err
    costs = {}
    known = ("-s", "solver.library=library/plan.h5")
    for method, more in (
        ("mccormick", ("-s", "solver.envelopes.rounds=1")),
        ("mpcc", ("-s", "solver.start=knn", *known)),
        ("pinned", known),
        ("knn", known),
    ):
        done = run_command(*base, "--method", method, *more, "--out", method, "--json")
        assert done.code == 0, done.err
        report = json.loads(done.out)
        assert report["verified"] is True
        assert report["results"][0]["method"] == method
        costs[method] = report["objective"]
    assert report["results"][0]["winner"].startswith("neighbour")
    best = min(costs.values())
    assert costs["mccormick"] == pytest.approx(best, rel=1e-3)
    assert all(cost <= 2 * best for cost in costs.values())


def test_springs_are_a_mixed_integer_quadratic_program(
    run_command: RunCommand, workplace: Path
) -> None:
    base = ("solve", str(SPEC), "--problem", SPRINGS, "--json", "--force")
    proved = json.loads(run_command(*base, "-s", "solver.gap=1e-4").out)
    assert proved["status"] == "optimal"
    assert proved["sizes"]["products"] == 0
    local = json.loads(run_command(*base, "--method", "mpcc").out)
    assert local["objective"] >= proved["bound"] - 1e-6


def test_several_rows(run_command: RunCommand, pond: Path) -> None:
    text = "kind: program\ntheta:\n  - {goal: [2, 2]}\n  - {goal: [1, 0]}\n"
    (pond / "two.yaml").write_text(text)
    done = run_command("solve", "two.yaml", "--problem", "own_pond:problem", "--time-limit", "30")
    assert done.code == 0, done.err
    with h5py.File("outputs/two/plan.h5") as file:
        assert file["parameters"].shape == (2, 2)
        assert file["x"].shape == (2, 3)
        np.testing.assert_allclose(file["objective"][()], [1.0, 0.0], atol=1e-5)
        assert file.attrs["objective"] == pytest.approx(1.0, abs=1e-5)
        assert json.loads(file.attrs["variable_blocks"])[0]["unit"] == "m"


def test_a_spec_alone_imports_nothing(run_command: RunCommand, pond: Path) -> None:
    (pond / "trap.py").write_text("raise SystemExit('imported')\n")
    (pond / "trap.yaml").write_text("kind: program\nproblem: trap:problem\ntheta: {goal: [1, 1]}\n")
    done = run_command("solve", "trap.yaml")
    assert done.code == 2
    assert "name the statement with --problem" in done.err
    assert "trap:problem" in done.err
    assert "trap" not in sys.modules
    assert run_command("validate", "trap.yaml").code == 0
    other = run_command("solve", "trap.yaml", "--problem", "own_pond.py:problem")
    assert other.code == 0
    assert "written for problem 'trap:problem'" in other.err


@pytest.mark.parametrize(
    ("problem", "fragment"),
    [
        ("nowhere:problem", "no module 'nowhere'"),
        ("nowhere.deep:problem", "no module 'nowhere.deep'"),
        ("none.py:problem", "no such file 'none.py'"),
        ("own_pond.py:lake", "has no 'lake' (it has problem, broken, misstated, cornered)"),
        ("own_pond.py:number", "expected a climbplan.program.Problem or a function"),
        ("own_pond.py:broken", "raised ZeroDivisionError: division by zero"),
        ("own_pond.py:misstated", "'x' is stated twice"),
        ("bad_import.py:problem", "importing bad_import.py raised ModuleNotFoundError"),
        ("bad_exit.py:problem", "raised SystemExit"),
        ("pond", "no entry point of that name"),
        (":problem", "expected MODULE:OBJECT"),
        ("own_pond:", "expected MODULE:OBJECT"),
    ],
)
def test_problems_that_cannot_be_used(
    run_command: RunCommand, pond: Path, problem: str, fragment: str
) -> None:
    (pond / "bad_import.py").write_text("import no_such_library\n")
    (pond / "bad_exit.py").write_text("raise SystemExit(0)\n")
    done = run_command("solve", "pond.yaml", "--problem", problem)
    assert (done.code, done.out) == (2, "")
    assert fragment in done.err
    assert "Traceback" not in done.err
    assert not (pond / "outputs").exists()


def test_what_a_statement_prints_is_no_result(run_command: RunCommand, pond: Path) -> None:
    (pond / "loud.py").write_text(
        "from own_pond import problem as quiet\nprint('loading')\n"
        "def problem():\n    print('stating')\n    return quiet()\n"
    )
    done = run_command("solve", "pond.yaml", "--problem", "loud.py:problem")
    assert (done.code, done.out) == (0, "outputs/pond/plan.h5\n")
    assert "loading\nstating\n" in done.err
    again = run_command("verify", "outputs/pond", "--problem", "loud.py:problem")
    assert again.code == 0
    assert "stating" not in again.out


@pytest.mark.parametrize("method", ["mccormick", "mpcc", "minlp-bonmin", "admm", "pinned"])
def test_one_variable_alone(run_command: RunCommand, pond: Path, method: str) -> None:
    (pond / "one.py").write_text(
        "from climbplan.program import Problem, Program\n"
        "p = Program('one')\nx = p.continuous('x', (1,), -1.0, 1.0)\n"
        "p.minimise('cost', (x[0] - 3) ** 2)\nproblem = Problem('one', p)\n"
    )
    (pond / "one.yaml").write_text("kind: program\n")
    done = run_command("solve", "one.yaml", "--problem", "one.py:problem", "--method", method)
    assert done.code == 0, done.err
    with h5py.File("outputs/one/plan.h5") as file:
        assert file.attrs["objective"] == pytest.approx(4.0, rel=1e-6)


def test_traceback_of_the_statement_when_asked_for(run_command: RunCommand, pond: Path) -> None:
    done = run_command("solve", "pond.yaml", "--problem", "own_pond.py:broken", "-v")
    assert done.code == 2
    assert "Traceback" in done.err
    assert "return 1 / 0" in done.err


@pytest.mark.parametrize(
    ("spec", "fragment"),
    [
        ("kind: program\ntheta: {goal: [1, a]}\n", "s.yaml:2: theta.goal: expected a number"),
        ("kind: program\ntheta:\n  goal: [1]\n", "s.yaml:2: theta: problem 'pond'"),
        ("kind: program\ntheta: []\n", "at least one mapping"),
        ("kind: program\ntheta: 3\n", "expected a mapping from parameter to numbers"),
        ("kind: program\n", "parameters ['goal'] expected"),
        ("kind: program\ntheta: {goal: [1, 1]}\nsample: {count: 2}\n", "got both"),
        ("kind: program\nsample: {count: 0}\n", "count: expected a whole number"),
        ("kind: program\nsolver: {method: knn}\n", "solver.library: method `knn`"),
        ("kind: program\nsolver: {method: magic}\n", "solver.method: expected one of"),
        ("kind: program\nsolver: {metod: micp}\n", "did you mean 'method'?"),
        ("kind: climb\n", "expected a spec of kind `program`"),
    ],
)
def test_specs_that_cannot_be_used(
    run_command: RunCommand, pond: Path, spec: str, fragment: str
) -> None:
    (pond / "s.yaml").write_text(spec)
    done = run_command("solve", "s.yaml", "--problem", "own_pond.py:problem")
    assert (done.code, done.out) == (2, "")
    assert fragment in done.err


def test_infeasible_names_its_blocks(run_command: RunCommand, pond: Path) -> None:
    done = run_command("solve", "pond.yaml", "--problem", "own_pond.py:cornered")
    assert (done.code, done.out) == (3, "")
    assert "proved infeasible" in done.err
    assert "east and tether conflict" in done.err
    assert "north" not in done.err
    local = ("solve", "pond.yaml", "--problem", "own_pond.py:cornered", "--method", "mpcc")
    assert run_command(*local).code == 4
    assert not (pond / "outputs").exists()


def test_libraries_that_do_not_fit(run_command: RunCommand, pond: Path) -> None:
    assert run_command("solve", "pond.yaml", "--problem", "own_pond.py:problem").code == 0
    wrong = ("-s", "solver.library=outputs/pond/plan.h5", "--method", "knn", "-o", "new")
    done = run_command("solve", "pond.yaml", "--problem", "own_pond.py:cornered", *wrong)
    assert done.code == 2
    assert "made for problem 'pond'" in done.err
    none = ("-s", "solver.library=none.h5", "--method", "knn", "-o", "new")
    assert run_command("solve", "pond.yaml", "--problem", "own_pond.py:problem", *none).code == 2


@pytest.mark.parametrize("suffix", ["lp", "mps", "nl", "cip"])
def test_save_model(run_command: RunCommand, pond: Path, suffix: str) -> None:
    line = ("solve", "pond.yaml", "--problem", "own_pond.py:problem", "--save-model")
    assert run_command(*line, f"model.{suffix}").code == 0
    assert (pond / f"model.{suffix}").stat().st_size > 100
    assert run_command(*line, "model.doc", "--force").code == 2


def test_an_installed_entry_point(run_command: RunCommand, pond: Path) -> None:
    """What an installed distribution leaves on the path, in a process that starts with it."""
    info = pond / "own_pond-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-pond\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[climbplan.problems]\npond = own_pond:problem\n")
    code = "import sys; sys.path.insert(0, '.'); from climbplan.cli.app import main; main()"
    line = [sys.executable, "-c", code, "solve", "pond.yaml", "--problem", "pond"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "outputs/pond/plan.h5\n"), done.stderr


def test_new_writes_the_statement_beside_the_spec(run_command: RunCommand, workplace: Path) -> None:
    done = run_command("new", "program", "own")
    assert (done.code, done.out) == (0, "own/cart_pole.yaml\n")
    assert (workplace / "own" / "cart_pole.py").read_text() == STATEMENT.read_text()
    assert run_command("new", "program", "own").code == 2


def test_rows_as_a_sequence(pond: Path, run_command: RunCommand) -> None:
    goals = "".join(f"  - goal: [2, {y}]\n" for y in (0.2, 1.0, 1.8))
    (pond / "pond.yaml").write_text(f"kind: program\ntheta:\n{goals}")
    command = ("solve", "pond.yaml", "--problem", "own_pond.py:problem")
    alone = run_command(*command, "--out", "alone")
    together = run_command(*command, "--out", "together", "--sequence", "--shift", "1")
    assert alone.code == together.code == 0, together.err
    with h5py.File(pond / "alone/plan.h5") as one, h5py.File(pond / "together/plan.h5") as other:
        assert np.allclose(one["objective"], other["objective"], rtol=2e-4)
    by_cuts = ("--sequence", "--shift", "1", "--method", "benders")
    assert run_command(*command, "--out", "cuts", *by_cuts).code == 0
    with h5py.File(pond / "alone/plan.h5") as one, h5py.File(pond / "cuts/plan.h5") as other:
        assert np.allclose(one["objective"], other["objective"], rtol=2e-4)
    refused = run_command(*command, "--shift", "1")
    assert refused.code == 2
    assert "--shift goes with --sequence" in refused.err
    refused = run_command(*command, "--sequence", "--method", "mpcc")
    assert refused.code == 2
    assert "solved by method branch-and-bound or benders, got 'mpcc'" in refused.err


def test_a_model_file_in_place_of_a_spec(run_command: RunCommand, workplace: Path) -> None:
    text = "NAME knap\nROWS\n N cost\n L size\nCOLUMNS\n m 'MARKER' 'INTORG'\n"
    text += "".join(f" x{i} cost -{i + 2} size {2 * i + 3}\n" for i in range(5))
    (workplace / "knap.mps").write_text(text + "RHS\n RHS size 12\nENDATA\n")
    done = run_command("solve", "knap.mps", "--certificate", "proof.h5", "--json")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    best = max(
        sum(i + 2 for i in range(5) if bits >> i & 1)
        for bits in range(32)
        if sum(2 * i + 3 for i in range(5) if bits >> i & 1) <= 12
    )
    assert report["objective"] == pytest.approx(-best)
    assert report["results"][0]["bound"] == pytest.approx(-best, rel=1e-4)
    assert run_command("verify", "outputs/knap", "--problem", "knap.mps").code == 0
    assert run_command("verify", "proof.h5", "--problem", "knap.mps").code == 0


def test_a_damaged_model_file(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "knap.mps").write_text("NAME knap\nROWS\n N cost\n Z size\n")
    done = run_command("solve", "knap.mps")
    assert done.code == 2
    assert "knap.mps:4: expected N, L, G or E" in done.err
    done = run_command("solve", "knap.mps", "--problem", STATEMENT.name)
    assert "leave --problem out" in done.err
