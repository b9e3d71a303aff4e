"""Write an instance to a model file that other solvers read.

Every form is written completely or rejected. SCIP's writer of .nl files drops indicator constraints
silently, so implications and choices are big-M rows there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.registry import require
from climbplan.solvers.separable_cost import is_convex

SUFFIXES = (".lp", ".mps", ".cip", ".nl")
_SCIP_CONVEX = frozenset({"balls", "choices"})
_MPS = frozenset({"balls", "choices", "implications", "integers", "integers beyond 0 and 1"})
_BY_BIG_M = frozenset({"integers", "choices", "implications"})


def save_model(instance: Instance, path: Path) -> None:
    """Write the program: .lp (CPLEX LP), .mps, .cip (SCIP) or .nl (AMPL, for nonlinear solvers).

    Rows, binaries, implications and choices become a mixed-integer linear or quadratic .lp or .mps
    by big-M, balls quadratic rows of an .mps file. With products, and with balls in an .lp file,
    these two contain quadratic rows, indicators and variables for squares. Variables are
    in the order of the instance. SCIP names them x<i>, products w<k>, the binaries of choices
    in<choice>_<alternative>. Names of an .nl file are in separate files (.col, .row).

    Raises:
        UsageError: The suffix is unknown, the file cannot be written, or a bound is missing.
        MissingSolver: PySCIPOpt is not installed.
    """
    if path.suffix not in SUFFIXES:
        raise UsageError(
            f"--save-model {path}: unknown suffix {path.suffix!r}, expected one of "
            + ", ".join(SUFFIXES)
        )
    if not path.parent.is_dir():
        raise UsageError(f"--save-model {path}: {path.parent} is not a directory")
    features = instance.features
    if "smooth" in features:
        raise UsageError(
            f"--save-model {path}: {instance.name!r} has smooth rows, which no format here holds"
        )
    if path.suffix == ".nl":
        _write_by_scip(_build_bilinear(BigM().apply(instance).instance), path)
    elif path.suffix == ".mps" and "balls" in features and features <= _MPS:
        from climbplan.solvers.mps_file import write_mps

        form = BigM().apply(instance)
        alternatives = [
            f"in{c}_{r}" for c, group in enumerate(form.binaries) for r in range(len(group))
        ]
        names = [f"x{i}" for i in range(instance.size)] + alternatives
        write_mps(form.instance, names, path)
    elif features <= _SCIP_CONVEX and is_convex(instance.P):
        require("scip")
        from climbplan.solvers.scip.model import build_convex_model

        _write_by_scip(build_convex_model(instance).model, path)
    elif features <= _BY_BIG_M and path.suffix != ".cip":
        from climbplan.solvers.highs.instances import save_highs_model

        save_highs_model(BigM().apply(instance).instance, path)
    else:
        _write_by_scip(_build_bilinear(instance), path)


def _build_bilinear(instance: Instance) -> Any:
    """Build SCIP's model of the whole statement."""
    require("minlp-scip")
    from climbplan.solvers.scip.bilinear import build_bilinear_model

    return build_bilinear_model(instance).model


def _write_by_scip(model: Any, path: Path) -> None:
    """Write a model with SCIP."""
    try:
        model.writeProblem(str(path), verbose=False)
    except OSError as error:
        raise UsageError(f"--save-model {path}: cannot be written: {error}") from error
    except KeyError as error:  # an older SCIP without a writer for the format
        raise UsageError(
            f"--save-model {path}: this SCIP does not write {path.suffix} files: {error}"
        ) from error
