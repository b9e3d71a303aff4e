"""The rooms' own pages (README.md beside the code) as pages of the site, their links turned."""

from __future__ import annotations

import os
import re
from pathlib import Path

_LINK = re.compile(r"\]\(([^)#:\s]+)(#[^)]*)?\)")


def room_pages(root: Path) -> dict[str, str]:
    """Text by page name: `walking.md`, `climb_grips.md`, `specs.md`."""
    places = {
        root / "specs" / "README.md": "specs.md",
        root / "benchmarks" / "README.md": "benchmarks.md",
        **{
            path: "_".join(path.parent.relative_to(root / "climbplan").parts) + ".md"
            for path in sorted((root / "climbplan").rglob("README.md"))
        },
    }
    return {name: _turned(path, places, root) for path, name in places.items()}


def _turned(page: Path, places: dict[Path, str], root: Path) -> str:
    """The page with links to other rooms' pages; links to other files become plain names."""

    def turn(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(page.parent / match[1]))
        if target in places:
            return f"]({places[target]}{match[2] or ''})"
        if target.is_relative_to(root / "docs"):
            return f"](../../{target.relative_to(root / 'docs')}{match[2] or ''})"
        raise ValueError(f"{page}: a link to {match[1]}, which is no page of the site")

    return _LINK.sub(turn, page.read_text(encoding="utf-8"))
