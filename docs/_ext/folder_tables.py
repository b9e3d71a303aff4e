"""The package's folders and files, each by the first line of its docstring."""

from __future__ import annotations

import ast
from pathlib import Path

from markdown_table import cell, table


def folders_page(package: Path) -> str:
    """A section a folder, a row a file."""
    lines = ["# Folders and files", ""]
    for folder in sorted({path.parent for path in package.rglob("*.py")}):
        name = folder.relative_to(package.parent).as_posix()
        rows = [
            (f"`{path.name}`", _first_line(path))
            for path in sorted(folder.glob("*.py"))
            if path.name != "__init__.py"
        ]
        lines += [f"## `{name}/`", "", cell(_first_line(folder / "__init__.py")), ""]
        if rows:
            lines.append(table(("file", "what it is for"), rows))
    return "\n".join(lines)


def _first_line(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0]
