"""Tables in Markdown, with cells that cannot break them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def cell(text: object) -> str:
    """Text on one line, its bars escaped."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Rows under a head."""
    lines = [list(head), ["---"] * len(head), *([cell(entry) for entry in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def wrapped_table(style: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in a box that the style sheet knows.

    Args:
        style: Classes of the box; rows of `stacked` ones become blocks on a narrow screen.
        head: Column titles.
        rows: Cells of each row.
    """
    return f":::{{container}} {style}\n\n{table(head, rows)}\n:::\n"
