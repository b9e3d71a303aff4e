"""Sphinx extension: writes the pages that are made from code and specs, before they are read.

They go to `docs/generated/`, which is not kept: key reference, gallery, robots, checks, solvers,
public names, benchmarks and the guides.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmark_page import benchmarks_page
from code_tables import api_page, checks_page, renamed_page, solvers_page
from folder_tables import folders_page
from gallery_page import gallery_page
from guide_pages import guide_pages
from page_pictures import pictures_page
from reference_names import SpecDomain
from robot_page import robot_grid, robots_page
from spec_keys import keys_page
from sphinx.application import Sphinx

from climbplan.schema.json_schema import json_schema
from climbplan.schema.kinds import KINDS


def pages(docs: Path) -> dict[str, str]:
    """Text of every generated page by its path below `docs/generated`."""
    root = docs.parent
    return {
        "api.md": api_page(),
        "benchmarks.md": benchmarks_page(docs / "benchmarks"),
        "folders.md": folders_page(root / "climbplan"),
        "checks.md": checks_page(),
        "solvers.md": solvers_page(),
        "renamed.md": renamed_page(),
        "gallery.md": gallery_page(root / "specs", docs / "gallery"),
        "pages.md": pictures_page(docs / "pages"),
        "robots.md": robots_page(docs),
        "robot_grid.txt": robot_grid(docs),  # which the landing page includes
        **{f"keys/{kind}.md": keys_page(kind, json_schema(kind)) for kind in KINDS},
        **{f"guides/{name}": text for name, text in guide_pages(root).items()},
    }


def write_pages(app: Sphinx) -> None:
    """Write what changed, remove what is gone."""
    folder = Path(app.srcdir) / "generated"
    wanted = {folder / name: text for name, text in pages(Path(app.srcdir)).items()}
    for old in folder.rglob("*.md"):
        if old not in wanted:
            old.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_domain(SpecDomain)
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True}
