"""Mathematical programs: variables, named blocks, disjunctions, exact check.

A problem is stated once as a `Program`; `Program.at(theta)` gives the numbers (`Instance`) that
solvers read, and `Program.check` judges any candidate, whatever made it.
"""

from climbplan.program.instance import Balls, Choice, Instance
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem, StatementError
from climbplan.program.residuals import BlockResidual, CheckReport
from climbplan.program.stage import Stage
from climbplan.program.statement import Program
from climbplan.program.trajectory import Trajectory

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
    "StatementError",
    "Trajectory",
]
