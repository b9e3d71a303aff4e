"""The decorator of compiled functions of the quasi-static simulator."""

from pathlib import Path

from climbplan.solvers.compiling import compiler

compiled = compiler(Path(__file__).parent, "*.py", borrows=True)
