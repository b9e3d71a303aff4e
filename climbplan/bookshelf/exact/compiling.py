"""The decorator of compiled functions of the exact branch and bound."""

from pathlib import Path

from climbplan.compiling import create_compiler

compiled = create_compiler(Path(__file__).parent, "*.py")
