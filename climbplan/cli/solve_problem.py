"""The problem that `--problem` names: the one place where a user's code is imported."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from climbplan.cli.console import Invocation
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.program.problem import Problem

GROUP = "climbplan.problems"

ProblemName = Annotated[
    str | None,
    typer.Option(
        "--problem",
        metavar="MODULE:OBJECT",
        help="The problem's statement: MODULE:OBJECT, FILE.py:OBJECT, or the name of an installed "
        f"entry point of the group {GROUP}, whose code is run; or a model file.",
    ),
]


def load_problem(name: str) -> Problem:
    """Import what a name stands for; the current directory is looked in like `python -m` does.

    Model files (.mps, .lp, .nl, .qplib) are read, and run no code.

    Raises:
        UsageError: there is no such module, object, entry point or file, or it is no problem.
        StatementError: the statement raised an exception, which is its cause.
    """
    from climbplan.solvers.model_files import is_model_file

    if is_model_file(name):
        from climbplan.solvers.model_files.reading import problem_from_file

        return problem_from_file(name)
    place, colon, attribute = name.rpartition(":")
    if not colon:
        return _as_problem(name, _load_entry_point(name))
    if not place or not attribute:
        raise UsageError(f"--problem {name}: expected MODULE:OBJECT, FILE.py:OBJECT or a name")
    module = (
        _import_file(name, Path(place)) if place.endswith(".py") else _import_module(name, place)
    )
    target: Any = module
    for attribute_name in attribute.split("."):
        if not hasattr(target, attribute_name):
            raise UsageError(
                f"--problem {name}: {place} has no {attribute!r}{_list_offers(module)}"
            )
        target = (
            vars(target)[attribute_name]
            if attribute_name in vars(target)
            else target.__getattribute__(attribute_name)
        )
    return _as_problem(name, target)


@contextmanager
def run_user_code(session: Invocation) -> Iterator[None]:
    """Run the user's code with its standard output sent to standard error.

    With `--verbose`, print the traceback of an exception that a statement raised.
    """
    from climbplan.program.problem import StatementError

    try:
        with redirect_stdout(sys.stderr):
            yield
    except StatementError as error:
        if session.verbose and error.__cause__ is not None:
            traceback.print_exception(error.__cause__)
        raise


@contextmanager
def _own_code(name: str, doing: str) -> Iterator[None]:
    """Report exceptions of the user's code as errors of the statement, not of climbplan."""
    from climbplan.program.problem import StatementError

    try:
        yield
    except UsageError as error:
        raise StatementError(f"--problem {name}: {error}") from (error.__cause__ or error)
    except (Exception, SystemExit) as error:
        raise StatementError(
            f"--problem {name}: {doing} raised {type(error).__name__}: {error}"
        ) from error


def _import_module(name: str, place: str) -> ModuleType:
    _add_to_path(Path.cwd())
    try:
        exists = importlib.util.find_spec(place) is not None
    except (ModuleNotFoundError, ValueError, ImportError):
        exists = False  # a parent package is missing, or the name is no module's
    if not exists:
        raise UsageError(
            f"--problem {name}: no module {place!r} on the path or in the current directory"
        )
    with _own_code(name, f"importing {place}"):
        return importlib.import_module(place)


def _import_file(name: str, path: Path) -> ModuleType:
    if not path.is_file():
        raise UsageError(f"--problem {name}: no such file {str(path)!r}")
    # Under a name of its own: a file called like an installed module must not take its place.
    module_name = f"climbplan_problem_{abs(hash(path.resolve())):x}"
    spec = importlib.util.spec_from_file_location(module_name, path.resolve())
    if spec is None or spec.loader is None:
        raise UsageError(f"--problem {name}: {str(path)!r} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses of the statement look themselves up
    _add_to_path(path.resolve().parent)  # what stands beside it can be imported, as when it is run
    with _own_code(name, f"importing {path}"):
        spec.loader.exec_module(module)
    return module


def _add_to_path(directory: Path) -> None:
    if os.fspath(directory) not in sys.path:
        sys.path.append(os.fspath(directory))


def _load_entry_point(name: str) -> Any:
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        installed = f"installed are {', '.join(sorted(points))}" if points else "none is installed"
        raise UsageError(
            f"--problem {name}: no entry point of that name in the group {GROUP} ({installed}); "
            "a statement in a file is named FILE.py:OBJECT"
        )
    with _own_code(name, f"importing {points[name].value}"):
        return points[name].load()


def _as_problem(name: str, candidate: Any) -> Problem:
    from climbplan.program.problem import Problem

    if not isinstance(candidate, Problem) and callable(candidate):
        with _own_code(name, "the statement"):
            candidate = candidate()
    if not isinstance(candidate, Problem):
        raise UsageError(
            f"--problem {name}: expected a climbplan.program.Problem or a function without "
            f"arguments that returns one, got {type(candidate).__name__}"
        )
    return candidate


def _list_offers(module: ModuleType) -> str:
    """List the problems and functions of a module, for a message."""
    from climbplan.program.problem import Problem

    offered_names = [
        key
        for key, value in vars(module).items()
        if isinstance(value, Problem)
        or (callable(value) and value.__module__ == module.__name__ and not key.startswith("_"))
    ]
    return f" (it has {', '.join(offered_names)})" if offered_names else ""
