"""The decorator of the compiled functions of walking."""

from pathlib import Path

from climbplan.compiling import create_compiler
from climbplan.robots import symbols
from climbplan.solvers.generated import hash_sources
from climbplan.walking.dynamics import dynamics

# All modules that `dynamics_step.py` is generated from: edits renew the cache
DECLARED = (dynamics, symbols)
compiled = create_compiler(Path(__file__).parent, "*.py", hash_sources(*DECLARED))
