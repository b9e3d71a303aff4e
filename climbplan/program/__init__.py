"""Mathematical programs: variables, named blocks, disjunctions, exact check.

A problem is stated once as a `Program`; `Program.at(theta)` gives the numbers (`Instance`) that
solvers read, and `Program.check` judges any candidate, whatever made it.
"""

from climbplan.deprecation import warn_renamed
from climbplan.program.instance import Balls, Choice, Instance
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem, StatementError
from climbplan.program.residuals import BlockResidual, CheckReport
from climbplan.program.stage import Stage
from climbplan.program.staged_program import StagedProgram
from climbplan.program.statement import Program

__all__ = [
    "Balls",
    "BlockResidual",
    "CheckReport",
    "Choice",
    "Instance",
    "Polytope",
    "Problem",
    "Program",
    "Stage",
    "StagedProgram",
    "StatementError",
]


def __getattr__(name: str) -> type[StagedProgram]:
    """Return a class by its old name, with a warning."""
    if name != "Trajectory":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_renamed("`climbplan.program.Trajectory`", "`climbplan.program.StagedProgram`")
    return StagedProgram
