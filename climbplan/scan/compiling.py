"""The decorator of this package's compiled functions."""

from __future__ import annotations

from pathlib import Path

from climbplan.compiling import create_compiler

compiled = create_compiler(Path(__file__).parent, "*.py")
