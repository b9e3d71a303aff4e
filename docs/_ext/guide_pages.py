"""Guides (the README.md of a package folder) as pages of the site, with their links rewritten."""

from __future__ import annotations

import os
import re
from pathlib import Path

_LINK = re.compile(r"\]\(([^)#:\s]+)(#[^)]*)?\)")


def guide_pages(root: Path) -> dict[str, str]:
    """Return the text of each guide by page name, such as `climb_forces_grips.md`."""
    names = {
        root / "specs" / "README.md": "specs.md",
        root / "benchmarks" / "README.md": "benchmarks.md",
        **{
            path: "_".join(path.parent.relative_to(root / "climbplan").parts) + ".md"
            for path in sorted((root / "climbplan").rglob("README.md"))
        },
    }
    return {name: _rewrite_links(path, names, root) for path, name in names.items()}


def _rewrite_links(page: Path, names: dict[Path, str], root: Path) -> str:
    """Return a page with its links to guides and to `docs/` as the site needs them.

    Raises ValueError for a link to any other file.
    """

    def rewrite(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(page.parent / match[1]))
        if target in names:
            return f"]({names[target]}{match[2] or ''})"
        if target.is_relative_to(root / "docs"):
            return f"](../../{target.relative_to(root / 'docs')}{match[2] or ''})"
        raise ValueError(f"{page}: a link to {match[1]}, which is no page of the site")

    return _LINK.sub(rewrite, page.read_text(encoding="utf-8"))
