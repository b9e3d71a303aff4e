"""The report of a bookshelf run: figures, page and numbers of one scene and of many."""

from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from headless_chromium import Browser, chromium_path
from matplotlib.image import imread

from climbplan.bookshelf.pages.figures import UNITS, rank_costliest
from climbplan.bookshelf.pages.report import build_report, list_figures, write_report
from climbplan.bookshelf.plan.file import write_shelf_plan
from climbplan.bookshelf.plan.shelf_plan import ShelfPlan, compute_totals
from climbplan.bookshelf.planner.runs import run_shelf
from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.reports.sheet import render_png

SPECS = Path(__file__).parents[2] / "specs"


def solved(name: str) -> ShelfPlan:
    return run_shelf(load_shelf(SPECS / f"{name}.yaml"))


@pytest.fixture(scope="module")
def one() -> ShelfPlan:
    return solved("bookshelf_scene")


@pytest.fixture(scope="module")
def many() -> ShelfPlan:
    """Forty scenes, some of which have lost their answer."""
    plan = solved("bookshelf_file")
    found = plan.solutions
    lost = np.zeros(40, bool)
    lost[[3, 4]] = True
    status = tuple("limit" if k == 3 else "infeasible" if k == 4 else s
                   for k, s in enumerate(found.status))  # fmt: skip
    solutions = replace(
        found,
        pose=np.where(lost[:, None, None], math.nan, found.pose),
        state=np.where(lost[:, None], -1, found.state),
        slot=np.where(lost, -1, found.slot),
        objective=np.where(lost, math.inf, found.objective),
        bound=np.where(lost, [-math.inf if k == 3 else math.inf for k in range(40)], found.bound),
        overlap=np.where(lost, math.nan, found.overlap),
        status=status,
        message=tuple("<b>$x$" if gone else "" for gone in lost),
    )
    return replace(plan, solutions=solutions, totals=compute_totals(solutions), title="<i>$40$")


@pytest.mark.parametrize("name", ["one", "many"])
def test_figures_are_drawn(name: str, request: pytest.FixtureRequest) -> None:
    plan = request.getfixturevalue(name)
    figures = list_figures(plan)
    assert set(figures) == ({"scene"} if name == "one" else {"statistics", "gallery_1"})
    for draw in figures.values():
        image = imread(io.BytesIO(render_png(draw(plan))))
        assert min(image.shape[:2]) > 500
        assert 0.02 < (image[..., :3] < 0.97).any(axis=-1).mean() < 0.9  # neither blank nor full


@pytest.mark.parametrize("name", ["one", "many"])
def test_files(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    plan = request.getfixturevalue(name)
    path = tmp_path / "plan.h5"
    write_shelf_plan(plan, path)
    write_report(path, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report == build_report(path)
    for figure in report["figures"]:
        assert (tmp_path / figure).read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "report.html").read_text()
    assert "$" not in re.sub(r"\$(40\$|x\$)", "", re.sub(r"base64,[^\"]*", "", page))
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)  # nothing from elsewhere
    assert "<script" not in page
    assert "script-src 'none'" in page
    assert "<i>" not in page
    assert "<b>" not in page


def test_numbers_of_one_scene(one: ShelfPlan, tmp_path: Path) -> None:
    write_shelf_plan(one, tmp_path / "plan.h5")
    report = build_report(tmp_path / "plan.h5")
    assert report["objective"] == one.solutions.objective[0]
    books = report["books"]
    assert isinstance(books, list)
    assert [book["book"] for book in books] == ["0", "1", "2", "inserted"]
    assert books[1]["after"] == one.solutions.pose[0, 1].tolist()
    assert books[3]["before"] is None


def test_numbers_of_many_scenes(many: ShelfPlan, tmp_path: Path) -> None:
    write_shelf_plan(many, tmp_path / "plan.h5")
    report = build_report(tmp_path / "plan.h5")
    cost = many.solutions.objective[many.solutions.placed]
    assert report["scenes"] == {
        "total": 40,
        "stored_books": 3,
        "optimal": 38,
        "feasible": 0,
        "infeasible": 1,
        "limit": 1,
        "nontrivial": int((cost > 1).sum()),
    }
    spread = report["cost"]
    assert isinstance(spread, dict)
    assert spread["all"]["mean"] == pytest.approx(cost.mean())
    assert spread["nontrivial"]["mean"] == pytest.approx(cost[cost > 1].mean())
    missing = report["without_placement"]
    assert isinstance(missing, list)
    assert [entry["scene"] for entry in missing] == [3, 4]
    assert [entry["objective"] for entry in missing] == [None, None]
    assert report["status"] == "limit"
    assert UNITS["objective"] == "mm^2"


def test_costliest_first(many: ShelfPlan) -> None:
    order = rank_costliest(many, 10)
    cost = many.solutions.objective[order]
    assert (np.diff(cost) <= 0).all()
    assert cost[0] == many.solutions.objective[many.solutions.placed].max()


@pytest.mark.skipif(chromium_path() is None, reason="no Chromium")
def test_page_in_a_browser(many: ShelfPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_shelf_plan(many, path)
    write_report(path, tmp_path)
    program = chromium_path()
    assert program is not None
    with Browser(program) as browser:
        browser.open(tmp_path / "report.html")
        assert browser.evaluate("document.images.length") == 2
        assert browser.evaluate("[...document.images].every(i => i.naturalWidth > 500)")
        assert browser.console == []
        asked = [r for r in browser.requests if not r.startswith("data:")]
        assert asked == [(tmp_path / "report.html").as_uri()]
