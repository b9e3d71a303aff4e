"""The site: it builds, shows what there is, finds names first and fits a phone."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from headless_chromium import Browser, chromium_path
from pages import ROOT, run

DOCS = ROOT / "docs"
SCREENS = ("index", "generated/gallery", "generated/robots", "generated/keys/climb",
           "generated/checks", "generated/solvers", "generated/benchmarks",
           "generated/guides/climb", "generated/guides/robots")  # fmt: skip
# What is typed into the search, and what has to come first
FIRST_RESULTS = {
    "min_normal_force": "generated/keys/climb.html#key-force-min_normal_force",
    "force.safety_friction": "generated/keys/climb.html#key-force-safety_friction",
    "trajectory.feet": "generated/checks.html#check-trajectory-feet",
    "daqp": "generated/solvers.html#solver-daqp",
    "climb_obstacle": "generated/gallery.html#scene-climb_obstacle",
    "walking": "generated/guides/walking.html",
    "plan files": "generated/guides/store.html",
}
MAX_PICTURE_BYTES = 60_000
MAX_FILM_BYTES = 1_500_000


@pytest.fixture(name="site", scope="module")
def _site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built without a warning."""
    if any(find_spec(module) is None for module in ("sphinx", "myst_parser", "furo")):
        pytest.skip("sphinx, myst-parser or furo is missing: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    done = run(f"{sys.executable} -m sphinx -q -W -b html {DOCS} {folder}", ROOT)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(name="browser", scope="module")
def _browser() -> Iterator[Browser]:
    program = chromium_path()
    if program is None:
        pytest.skip("no chromium found: pages are not looked at")
    with Browser(program) as browser:
        yield browser


def test_site_builds_without_warnings(site: Path) -> None:
    for kind in ("climb", "mpc", "module"):
        assert (site / "generated" / "keys" / f"{kind}.html").exists()
    keys = (site / "generated" / "keys" / "climb.html").read_text()
    assert "safety_friction" in keys


def test_names_have_anchors_of_their_own(site: Path) -> None:
    for page in ("keys/climb", "keys/transition", "checks", "solvers", "gallery", "robots"):
        text = (site / "generated" / f"{page}.html").read_text()
        anchors = Counter(part.partition('"')[0] for part in text.split(' id="')[1:])
        assert not [name for name, count in anchors.items() if count > 1], page


def test_the_search_finds_names_and_pages_first(site: Path, browser: Browser) -> None:
    for query, first in FIRST_RESULTS.items():
        browser.visit(f"{(site / 'search.html').as_uri()}?q={query.replace(' ', '+')}")
        browser.wait_for("/finished/.test(document.querySelector('.search-summary')?.innerText)")
        link = browser.evaluate("document.querySelector('ul.search a')?.getAttribute('href')")
        assert link == first, query


def test_pages_fit_a_phone(site: Path, browser: Browser) -> None:
    browser.emulate(width=390, height=844, phone=True)
    for page in SCREENS:
        browser.open(site / f"{page}.html")
        assert browser.evaluate("document.documentElement.scrollWidth") <= 390, page


def test_pictures_are_small_and_as_many_as_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS / "_ext")
    from gallery_page import COURSES, FILMS, scenes
    from robot_page import SHIPPED, read_public_robots

    names = {scene.name for scene in scenes(ROOT / "specs")}
    assert {path.stem for path in (DOCS / "gallery" / "thumbnails").iterdir()} <= names
    films = {path.name: path.stat().st_size for path in (DOCS / "gallery" / "films").iterdir()}
    beside_stills = {
        f"{name}_{kind}.webp" for name in (*FILMS, *COURSES) for kind in ("film", "still")
    }
    assert set(films) == {*beside_stills, "closed_loop_film.webp"}
    assert max(films.values()) <= MAX_FILM_BYTES
    robots = [*SHIPPED, *read_public_robots(DOCS / "benchmarks" / "zoo.json")]
    assert {path.stem for path in (DOCS / "robots").iterdir()} == {one.name for one in robots}
    pictures = [*(DOCS / "gallery" / "thumbnails").iterdir(), *(DOCS / "robots").iterdir()]
    assert max(path.stat().st_size for path in pictures) <= MAX_PICTURE_BYTES
