"""The decorator of compiled functions of the quasi-static simulator."""

from pathlib import Path

from climbplan.compiling import create_compiler

compiled = create_compiler(Path(__file__).parent, "*.py", borrows_references=True)
