"""The page of measured benchmarks, made from the records that `docs/benchmarks/` holds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer
from markdown_table import cell, wrapped_table

HEAD = """# Measured benchmarks

Each section is one run of `python -m benchmarks NAME --json docs/benchmarks/NAME.json` and is made
from that record alone. Ratios of one run may be compared; seconds change with the machine and its
load.
"""


def benchmarks_page(folder: Path) -> str:
    """A section for each record, by name."""
    records = [
        json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))
    ]
    purposes = describe_benchmarks()
    sections = [section(record, purposes[record["benchmark"]]) for record in records]
    return "\n".join([HEAD, *sections])


def describe_benchmarks() -> dict[str, str]:
    """Return what each benchmark measures, by its name, as `--list` prints it."""
    from benchmarks.app import app

    commands = typer.main.get_group(app).commands
    return {name: command.get_short_help_str(limit=120) for name, command in commands.items()}


def section(record: Mapping[str, Any], purpose: str) -> str:
    """Return what was run, when, on what, with which versions, and its tables."""
    options = " ".join(
        f"--{name.replace('_', '-')}" + ("" if value is True else f" {value}")
        for name, value in record["options"].items()
        if value not in (None, False)
    )
    machine = record["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
    lines = [
        f"## {record['benchmark']}",
        "",
        purpose,
        "",
        f"`python -m benchmarks {record['benchmark']} {options}".rstrip() + "`",
        f"on {record['date'][:10]}, commit {(record['commit'] or 'unknown')[:12]}:",
        f"{machine['cpu_count']} processors, {machine['platform']}.",
        "",
    ]
    for one in record["results"]["tables"]:
        if one["title"]:
            lines += [*(f"{cell(line)}  " for line in one["title"].splitlines()), ""]
        if one["header"]:
            width = max(len(row) for row in (one["header"], *one["rows"]))
            rows = [[*row, *[""] * (width - len(row))] for row in one["rows"]]
            head = [*one["header"], *[""] * (width - len(one["header"]))]
            lines.append(wrapped_table("measured", head, rows))
    lines += [":::{container} versions", "", f"Versions: {versions}.", "", ":::", ""]
    return "\n".join(lines)
