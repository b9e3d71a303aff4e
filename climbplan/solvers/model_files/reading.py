"""Read a model file as a problem, by its suffix.

Own readers hold .mps and .qplib. HiGHS reads .lp. SCIP checks .nl, which CasADi then reads: CasADi
alone does not return from a damaged file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import casadi as ca
import highspy
import numpy as np
from scipy import sparse

from climbplan.errors import UsageError
from climbplan.program.casadi_form import state_casadi_problem
from climbplan.program.problem import Problem
from climbplan.program.statement import Program
from climbplan.reading import read_text
from climbplan.solvers.highs.model import QuietHighs
from climbplan.solvers.model_files import SUFFIXES
from climbplan.solvers.model_files.mps import read_mps
from climbplan.solvers.model_files.qplib import read_qplib
from climbplan.solvers.model_files.quadratic_model import (
    MAX_BYTES,
    MAX_ROWS,
    MAX_VARIABLES,
    QuadraticModel,
    state_model,
)


def problem_from_file(path: str | Path) -> Problem:
    """Read a model file as a problem without parameters.

    Each variable of the file is a block (1,) of its name. The cost of a maximisation is negated.

    Args:
        path: A file .mps, .lp, .nl or .qplib.

    Raises:
        UsageError: The suffix is another one, the file cannot be read, is too large or damaged
            (with the line), or states what programs here do not hold.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"{path}: expected a model file {', '.join(SUFFIXES)}")
    try:
        program = _read_nl(path) if suffix == ".nl" else state_model(_READERS[suffix](path))
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from error
    return Problem(path.name, program)


def _read_lp(path: Path) -> QuadraticModel:
    """Read an .lp file (CPLEX LP) by HiGHS.

    Raises:
        UsageError: HiGHS finds a mistake.
    """
    read_text(path, MAX_BYTES, "an LP file")
    messages: list[str] = []
    highs: Any = QuietHighs()  # type: ignore[no-untyped-call]
    highs.setOptionValue("log_to_console", False)  # the callback below gets the messages
    highs.setOptionValue("output_flag", True)
    highs.cbLogging += lambda event: messages.append(event.message)
    if highs.readModel(str(path)) != highspy.HighsStatus.kOk:
        raise UsageError(_describe_lp_error(path, "".join(messages)))
    model = highs.getModel()
    lp, hessian = model.lp_, model.hessian_
    n, m = lp.num_col_, lp.num_row_
    if not n:
        raise UsageError(f"{path}: expected at least one variable")
    if n > MAX_VARIABLES or m > MAX_ROWS:
        raise UsageError(
            f"{path}: {n} variables and {m} rows; {MAX_VARIABLES} and {MAX_ROWS} at most expected"
        )
    kinds = list(lp.integrality_) or [highspy.HighsVarType.kContinuous] * n
    allowed = (highspy.HighsVarType.kContinuous, highspy.HighsVarType.kInteger)
    if any(kind not in allowed for kind in kinds):
        raise UsageError(f"{path}: expected no semi-continuous variables: state a binary for each")
    P = sparse.csr_matrix((n, n))
    if hessian.dim_:
        places = np.array(hessian.index_), np.array(hessian.start_)
        triangle = sparse.csc_matrix((hessian.value_, *places), shape=(n, n))
        P = sparse.csr_matrix(triangle + sparse.tril(triangle, -1).T)
    A = lp.a_matrix_
    stored = sparse.csc_matrix if A.format_ == highspy.MatrixFormat.kColwise else sparse.csr_matrix
    return QuadraticModel(
        name=path.stem,
        variables=tuple(lp.col_names_),
        lower=np.array(lp.col_lower_),
        upper=np.array(lp.col_upper_),
        integer=np.array([kind == highspy.HighsVarType.kInteger for kind in kinds]),
        P=P,
        q=np.array(lp.col_cost_),
        constant=float(lp.offset_),
        maximise=lp.sense_ == highspy.ObjSense.kMaximize,
        rows=tuple(lp.row_names_),
        A=stored((A.value_, A.index_, A.start_), shape=(m, n)).tocsr(),
        row_lower=np.array(lp.row_lower_),
        row_upper=np.array(lp.row_upper_),
        curvature={},
    )


def _describe_lp_error(path: Path, messages: str) -> str:
    """Return what HiGHS reports about a file, with the line where it names one."""
    lines = [line.removeprefix("ERROR:").strip() for line in messages.splitlines() if line.strip()]
    place = re.search(rf"{re.escape(str(path))}:(\d+)", messages)
    what = lines[0] if lines else "not an LP file"
    if "quadratic" in messages and "constraint" in messages:
        what += "; write the model as .mps, which holds them"
    return f"{path}:{place.group(1)}: {what}" if place else f"{path}: {what}"


_READERS: dict[str, Callable[[Path], QuadraticModel]] = {
    ".mps": read_mps,
    ".qplib": read_qplib,
    ".lp": _read_lp,
}


def _read_nl(path: Path) -> Program:
    """Read an .nl file (AMPL, text form): quadratic where it is, else with smooth rows.

    Raises:
        UsageError: SCIP or CasADi finds a mistake, or the header counts too much.
    """
    text = read_text(path, MAX_BYTES, "an .nl file in text form (g)")
    _check_nl_header(path, text.splitlines())
    _check_by_scip(path)
    builder = ca.NlpBuilder()
    try:
        builder.import_nl(str(path), {})
        x = ca.SX.sym("x", len(builder.x))
        f, g = ca.Function(
            "nlp", [ca.vertcat(*builder.x)], [builder.f, ca.vertcat(*builder.g)]
        ).call([x])
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise UsageError(f"{path}: CasADi cannot read it: {reason}") from error
    model = _extract_quadratic(path.stem, builder, x, f, g)
    if model is not None:
        return state_model(model)
    program = Program(path.stem)
    nlp = {"x": x, "f": f} | ({"g": g} if g.numel() else {})
    state_casadi_problem(
        program,
        nlp,
        lbx=np.array(builder.x_lb),
        ubx=np.array(builder.x_ub),
        lbg=np.array(builder.g_lb) if g.numel() else -np.inf,
        ubg=np.array(builder.g_ub) if g.numel() else np.inf,
        discrete=builder.discrete,
    )
    return program


def _check_nl_header(path: Path, lines: list[str]) -> None:
    """Check the form and the sizes that an .nl file states.

    Raises:
        UsageError: It is another form, or too large.
    """
    if not lines or not lines[0].startswith("g"):
        raise UsageError(f"{path}:1: expected an .nl file in text form, which begins with g")
    tokens = lines[1].split()[:2] if len(lines) > 1 else []
    counts = [int(token) for token in tokens if token.isdigit()]
    if len(counts) < 2:
        raise UsageError(f"{path}:2: expected the numbers of variables and rows")
    if not 1 <= counts[0] <= MAX_VARIABLES or counts[1] > MAX_ROWS:
        raise UsageError(
            f"{path}:2: {counts[0]} variables and {counts[1]} rows; from 1 to {MAX_VARIABLES} and "
            f"up to {MAX_ROWS} expected"
        )


def _check_by_scip(path: Path) -> None:
    """Let SCIP read a file, which finds mistakes and their lines.

    Raises:
        UsageError: There is a mistake.
    """
    import pyscipopt

    model, errors = pyscipopt.Model(), io.StringIO()
    model.redirectOutput()
    try:
        with redirect_stderr(errors), redirect_stdout(io.StringIO()):
            model.readProblem(str(path))
    except (OSError, KeyError) as error:
        mistake = re.search(r"ERROR: (?:.*?:)?(\d+):\d+: (.*)", errors.getvalue())
        if mistake:
            raise UsageError(f"{path}:{mistake.group(1)}: {mistake.group(2)}") from error
        reason = errors.getvalue().strip() or str(error)
        raise UsageError(f"{path}: SCIP cannot read it: {reason}") from error


def _extract_quadratic(name: str, builder: Any, x: Any, f: Any, g: Any) -> QuadraticModel | None:
    """Return the numbers of a program whose cost and rows are quadratic; None for others."""
    zero = ca.DM.zeros(x.shape)
    n, m = x.numel(), g.numel()
    is_curved = ca.which_depends(g, x, 2, True) if m else []
    is_curved = is_curved if isinstance(is_curved, list) else [is_curved]
    curvature: dict[int, sparse.csr_matrix] = {}
    for i in np.flatnonzero(is_curved):
        H = _evaluate_hessian(g[int(i)], x)
        if H is None:
            return None
        curvature[int(i)] = H
    P = _evaluate_hessian(f, x)
    if P is None:
        return None
    numbers = ca.Function(
        "numbers", [x], [ca.gradient(f, x), f, ca.jacobian(g, x) if m else ca.SX(0, n), g]
    )
    q, constant, A, offsets = numbers(zero)
    offset = np.array(offsets).ravel()
    return QuadraticModel(
        name=name,
        variables=tuple(f"x{i}" for i in range(n)),
        lower=np.array(builder.x_lb),
        upper=np.array(builder.x_ub),
        integer=np.array(builder.discrete, bool),
        P=P,
        q=np.array(q).ravel(),
        constant=float(constant),
        maximise=False,
        rows=tuple(f"g{i}" for i in range(m)),
        A=sparse.csr_matrix(A.sparse()) if m else sparse.csr_matrix((0, n)),
        row_lower=np.array(builder.g_lb) - offset,
        row_upper=np.array(builder.g_ub) - offset,
        curvature=curvature,
    )


def _evaluate_hessian(expression: Any, x: Any) -> sparse.csr_matrix | None:
    """Return the Hessian of a quadratic scalar, None where it is not constant."""
    hessian = ca.hessian(expression, x)[0]
    if ca.depends_on(hessian, x):
        return None
    value = ca.Function("hessian", [x], [hessian])(ca.DM.zeros(x.shape))
    return sparse.csr_matrix(value.sparse())
