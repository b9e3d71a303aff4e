"""Writing an instance to a model file that other solvers read."""

from __future__ import annotations

from pathlib import Path

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.registry import require

SUFFIXES = (".lp", ".mps", ".cip")


def save_model(instance: Instance, path: Path) -> None:
    """Write the mixed-integer form: .lp (CPLEX LP), .mps or .cip (SCIP).

    Variables are x0, x1, ... in order of the instance, in<choice>_<alternative> its binaries.
    Raises UsageError for another suffix or an unwritable place, MissingSolver without PySCIPOpt.
    """
    if path.suffix not in SUFFIXES:
        raise UsageError(
            f"--save-model {path}: unknown suffix {path.suffix!r}, expected one of "
            + ", ".join(SUFFIXES)
        )
    if not path.parent.is_dir():
        raise UsageError(f"--save-model {path}: {path.parent} is not a directory")
    require("scip")
    from climbplan.solvers.scip_model import scip_model

    try:
        scip_model(instance).model.writeProblem(str(path), verbose=False)
    except OSError as error:
        raise UsageError(f"--save-model {path}: cannot be written: {error}") from error
