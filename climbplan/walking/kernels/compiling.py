"""The decorator of compiled functions of walking."""

from pathlib import Path

from climbplan.robots import symbols
from climbplan.solvers.compiling import compiler
from climbplan.solvers.generated import generated_from
from climbplan.walking.dynamics import dynamics

DECLARED = (dynamics, symbols)  # all modules that `step.py` is generated from: edits renew it
compiled = compiler(Path(__file__).parent, "*.py", generated_from(*DECLARED))
