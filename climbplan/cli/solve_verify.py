"""`climbplan verify` of answers to a stated program: the statement is needed for its blocks."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from climbplan.cli.console import Invocation, print_json, print_result
from climbplan.cli.solve_problem import load_problem, run_user_code
from climbplan.cli.verify_line import format_badge, warn_of_implausible
from climbplan.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from climbplan.schema.holding import HeldSpec
    from climbplan.verification.verification import Verification


def verify_program_file(
    path: Path, name: str | None, as_json: bool, session: Invocation, other_spec: HeldSpec | None
) -> bool:
    """Check a certificate, dataset or plan of a stated program; False for files of other kinds.

    Raises:
        UsageError: the file needs a statement and `name` is None, or `held` comes with a
            certificate.
    """
    if is_certificate(path):
        if other_spec is not None:
            raise UsageError(
                "--spec: a certificate is checked against its own numbers; leave --spec out"
            )
        verify_certificate_file(path, name, as_json, session)
    elif is_program_dataset(path):
        verify_program_dataset(path, name, as_json, session)
    elif is_program_plan(path):
        verify_program_plan(path, name, as_json, session, other_spec)
    else:
        return False
    return True


def is_program_plan(path: Path) -> bool:
    """Return whether the file holds solutions of a stated program."""
    from climbplan.store.plan_format import read_plan_format
    from climbplan.store.program_file import FORMAT

    return read_plan_format(path) == FORMAT


def verify_program_plan(
    path: Path,
    name: str | None,
    as_json: bool,
    session: Invocation,
    other_spec: HeldSpec | None = None,
) -> None:
    """Check a `climbplan/program` file, its blocks by the statement that `name` stands for.

    other_spec: a spec that the answers are held against in place of their own.

    Raises:
        UsageError: without a statement, after what the file alone allows was checked and printed.
    """
    from climbplan.store.program_file import read_program
    from climbplan.verification.programs import verify_file, verify_program

    plan = read_program(path)
    if name is None:
        verification = verify_file(plan, other_spec)
    else:
        with run_user_code(session):
            verification = verify_program(plan, load_problem(name), other_spec)
    tell(verification, as_json)
    if name is None:
        raise UsageError(
            f"{path}: only the file itself was checked (text, bounds, integrality); the rows of "
            f"{plan.problem!r} need its statement: add --problem MODULE:OBJECT"
        )


def is_certificate(path: Path) -> bool:
    """Return whether the file holds certificates of bounds."""
    from climbplan.store.certificate_file import FORMAT
    from climbplan.store.plan_format import read_plan_format

    return read_plan_format(path) == FORMAT


def verify_certificate_file(
    path: Path, name: str | None, as_json: bool, session: Invocation
) -> None:
    """Check the proofs in a file, with `name` also whether they are about that statement."""
    from climbplan.store.certificate_file import read_certificates
    from climbplan.verification.certificates import verify_certificates

    certified = read_certificates(path)
    leaves = sum(len(row.certificate.empty) for row in certified.rows)
    begin = time.perf_counter()
    with run_user_code(session):
        problem = None if name is None else load_problem(name)
        verification = verify_certificates(certified, problem)
    session.note(f"proofs    {leaves} leaves checked in {time.perf_counter() - begin:.2f} s")
    tell(verification, as_json)


def is_program_dataset(path: Path) -> bool:
    """Return whether the file is a dataset of a stated program."""
    from climbplan.methods.dataset_rows import KIND
    from climbplan.store.dataset_file import FORMAT, read_dataset_file
    from climbplan.store.plan_format import read_plan_format

    return read_plan_format(path) == FORMAT and read_dataset_file(path).frame.kind == KIND


def verify_program_dataset(
    path: Path, name: str | None, as_json: bool, session: Invocation
) -> None:
    """Check a dataset of a stated program, as `verify_program_plan` does a plan.

    Raises:
        UsageError: without a statement, after what the file alone allows was checked and printed.
    """
    from climbplan.datasets.check.verification import verify_dataset
    from climbplan.store.dataset_file import read_dataset_file

    data = read_dataset_file(path)
    with run_user_code(session):
        problem = None if name is None else load_problem(name)
        verification = verify_dataset(data, path, problem)
    tell(verification, as_json)
    if name is None:
        raise UsageError(
            f"{path}: only the file itself was checked; the rows of {data.frame.problem!r} need "
            "its statement: add --problem MODULE:OBJECT"
        )


def tell(verification: Verification, as_json: bool) -> None:
    """Print a verification: what is implausible first, on standard error, then what it is worth.

    Raises:
        typer.Exit: a check failed, or data are implausible.
    """
    warn_of_implausible(verification)
    if as_json:
        print_json(verification.as_dict())
    else:
        print_result("\n".join([*format_badge(verification), verification.table()]))
    if verification.objection:
        raise typer.Exit(ExitCode.UNVERIFIED)
