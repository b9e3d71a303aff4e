"""Every hard run names a function that exists, so that Ctrl-C is pressed inside its solver."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from hard_runs import RUNS

import climbplan

PACKAGE = Path(climbplan.__file__).parent


@pytest.mark.parametrize("name", RUNS)
def test_the_function_of_a_hard_run_exists(name: str) -> None:
    run = RUNS[name]
    files = [file for file in PACKAGE.rglob("*.py") if file.as_posix().endswith(run.file)]
    names = {
        node.name
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
    }
    assert run.function in names, (run.file, run.function)
