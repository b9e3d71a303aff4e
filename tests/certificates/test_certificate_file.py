"""Certificates as files and on the command line: written, read, compared, refused."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from climbplan.cli.app import app
from climbplan.errors import PlanFileError
from climbplan.store.certificate_file import read_certificates, write_certificates
from climbplan.verification.certificates import verify_certificates

STATEMENT = """
import numpy as np
from climbplan.program import Polytope, Problem, Program


def stated(shift=0.0):
    p = Program("hop")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (3, 2), -3.0, 3.0)
    z = p.binary("z", (3,))
    p.between("start", x[0], 0.0, 0.0)
    for k in range(2):
        p.ball(f"step{k}", (x[k + 1] - x[k])[None, :], 1.2)
        p.when(f"low{k}", z[k], x[k + 1][:1], -3.0, 0.5 + shift)
    stones = [
        Polytope.halfspaces(
            f"stone{i}",
            np.vstack([np.eye(2), -np.eye(2)]),
            np.array([c + 0.3, 0.3, 0.3 - c, 0.3]),
        )
        for i, c in enumerate((0.0, 0.9, 1.8))
    ]
    p.one_of("stones", x[1:], [stones, stones])
    p.exactly_one("one", z)
    p.minimise("far", np.sum((x[2] - goal) ** 2))
    p.minimise("fixed", np.array([0.1, 0.2, 0.4]) @ z)
    return Problem("hop", p)


problem = stated()
other = stated(0.01)
"""
SPEC = "kind: program\ntheta:\n  - goal: [1.7, 0.1]\n  - goal: [-0.2, 0.0]\nsolver: {gap: 1e-4}\n"

runner = CliRunner()


@pytest.fixture(name="room", scope="module")
def _room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a statement, a spec and its certificate."""
    room = tmp_path_factory.mktemp("hop")
    (room / "hop.py").write_text(STATEMENT)
    (room / "hop.yaml").write_text(SPEC)
    result = runner.invoke(
        app,
        ["solve", str(room / "hop.yaml"), "--problem", f"{room / 'hop.py'}:problem",
         "--out", str(room / "out"), "--certificate", str(room / "proof.h5")],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "leaves" in result.output
    return room


def test_it_proves_what_was_solved(room: Path) -> None:
    result = runner.invoke(
        app, ["verify", str(room / "proof.h5"), "--problem", f"{room / 'hop.py'}:problem"]
    )
    assert result.exit_code == 0, result.output
    for name in ("statement", "proof", "bound", "point", "gap"):
        assert f"certificate.{name}" in result.output
    assert "verified\n" in result.output


def test_the_file_alone_says_what_it_leaves_out(room: Path) -> None:
    result = runner.invoke(app, ["verify", str(room / "proof.h5")])
    assert result.exit_code == 0, result.output
    assert "without --problem" in " ".join(result.output.split())


def test_another_statement_is_noticed(room: Path) -> None:
    result = runner.invoke(
        app, ["verify", str(room / "proof.h5"), "--problem", f"{room / 'hop.py'}:other"]
    )
    assert result.exit_code == 5
    assert "implications" in result.output


def test_what_is_read_is_what_was_written(room: Path, tmp_path: Path) -> None:
    once = read_certificates(room / "proof.h5")
    write_certificates(once, tmp_path / "again.h5")
    twice = read_certificates(tmp_path / "again.h5")
    assert len(twice.rows) == 2
    for one, two in zip(once.rows, twice.rows, strict=True):
        assert one.certificate.bound == two.certificate.bound
        assert np.array_equal(one.certificate.point, two.certificate.point)
        assert (one.certificate.multiplier != two.certificate.multiplier).nnz == 0
        assert one.instance.features == two.instance.features
    assert verify_certificates(twice).passed


def test_it_is_not_replaced_unasked(room: Path) -> None:
    command = ["solve", str(room / "hop.yaml"), "--problem", f"{room / 'hop.py'}:problem",
               "--out", str(room / "second"), "--certificate", str(room / "proof.h5")]  # fmt: skip
    result = runner.invoke(app, command)
    assert result.exit_code == 2
    assert "--force" in result.output


def test_nothing_feasible_is_proved_too(room: Path) -> None:
    spec = room / "far.yaml"
    spec.write_text(SPEC)
    statement = room / "far.py"
    statement.write_text(STATEMENT.replace('"start", x[0], 0.0, 0.0', '"start", x[0], -2.0, -2.0'))
    proof = room / "far.h5"
    result = runner.invoke(
        app,
        ["solve", str(spec), "--problem", f"{statement}:problem", "--out", str(room / "far"),
         "--certificate", str(proof)],
    )  # fmt: skip
    assert result.exit_code == 3
    result = runner.invoke(app, ["verify", str(proof), "--problem", f"{statement}:problem"])
    assert result.exit_code == 0, result.output
    assert "certificate.infeasible" in result.output


def test_other_methods_prove_nothing(room: Path) -> None:
    result = runner.invoke(
        app,
        ["solve", str(room / "hop.yaml"), "--problem", f"{room / 'hop.py'}:problem", "--out",
         str(room / "scip"), "--method", "minlp-scip", "--certificate", str(room / "scip.h5")],
    )  # fmt: skip
    assert result.exit_code == 2
    assert "branch-and-bound" in result.output


def _changed(room: Path, tmp_path: Path, name: str, value: object) -> Path:
    path = tmp_path / "changed.h5"
    path.write_bytes((room / "proof.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        file[f"rows/000000/{name}"][...] = value
    return path


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("problem/A/column", 10**6),
        ("problem/implications/binary", -1),
        ("proof/multiplier/row", 10**9),
        ("assignment", 7),
        ("proof/point", np.nan),
    ],
)
def test_damage_is_told(room: Path, tmp_path: Path, name: str, value: float) -> None:
    with pytest.raises(PlanFileError):
        read_certificates(_changed(room, tmp_path, name, value))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("proof/multiplier/value", 1.0),
        ("proof/split", -1),
        ("proof/at", -5.0),
        ("proof/empty", True),
        ("x", 0.0),
        ("problem/q", 5.0),
    ],
)
def test_forged_numbers_fail(room: Path, tmp_path: Path, name: str, value: float) -> None:
    path = _changed(room, tmp_path, name, value)
    assert runner.invoke(app, ["verify", str(path)]).exit_code == 5


def test_a_claim_beyond_the_proof_fails(room: Path, tmp_path: Path) -> None:
    path = tmp_path / "claim.h5"
    path.write_bytes((room / "proof.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        file["rows/000001/proof"].attrs["bound"] += 0.01
    result = runner.invoke(app, ["verify", str(path)])
    assert result.exit_code == 5
    assert "certificate.bound" in result.output


SHELF = """
kind: bookshelf
title: A book has to give way
shelf: {left_mm: -50, right_mm: 50, height_mm: 110}
scene:
  books: [{x_mm: 5, height_mm: 68, width_mm: 40}]
  insert: {height_mm: 65, width_mm: 55}
"""
BOOKS = """
kind: program
theta: {size: [[68, 40], [65, 55]], pose: [[5, 34, 0]]}
solver: {gap: 1e-3, method: branch-and-bound}
"""


def test_a_shelf_of_books_is_certified_end_to_end(tmp_path: Path) -> None:
    """Products: solved, written, verified from the file and against the statement, forged."""
    (tmp_path / "shelf.yaml").write_text(SHELF)
    (tmp_path / "books.yaml").write_text(BOOKS)
    (tmp_path / "shelf.py").write_text(
        "import climbplan\n"
        f"problem, _ = climbplan.problem_from_spec({str(tmp_path / 'shelf.yaml')!r})\n"
    )
    proof, statement = str(tmp_path / "proof.h5"), f"{tmp_path / 'shelf.py'}:problem"
    result = runner.invoke(
        app,
        ["solve", str(tmp_path / "books.yaml"), "--problem", statement,
         "--out", str(tmp_path / "out"), "--certificate", proof],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    result = runner.invoke(app, ["verify", proof, "--problem", statement])
    assert result.exit_code == 0, result.output
    assert "certificate.gap" in result.output
    row = read_certificates(Path(proof)).rows[0]
    assert row.certificate.bound == pytest.approx(400.0, rel=1.1e-3)
    with h5py.File(proof, "r+") as file:
        file["rows/000000/problem/products/first"][0] += 1
    assert runner.invoke(app, ["verify", proof]).exit_code == 5
    assert runner.invoke(app, ["verify", proof, "--problem", statement]).exit_code == 5
