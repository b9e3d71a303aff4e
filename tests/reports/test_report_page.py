"""The HTML page: self-contained, safe with any names, and alive in a browser."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from headless_chromium import Browser, chromium_path

from climbplan.climb.pages.page import build_page
from climbplan.climb.pages.report import build_report
from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.climb.plan.file import write_climb

MakePlan = Callable[..., ClimbPlan]
ATTACK = "<script>window.broken=1</script><img src=x onerror=window.broken=1>\"'&$title"
DOT = base64.b64decode(  # a PNG of one pixel
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
)


class Page(HTMLParser):
    """Tags with attributes, and the text of data and scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open = tag

    def handle_data(self, data: str) -> None:
        self.texts[self._open] = self.texts.get(self._open, "") + data


def hostile(plan: ClimbPlan) -> ClimbPlan:
    """The plan with markup in every name and text."""
    names = tuple(f"{ATTACK}{i}" for i in range(plan.robot.limb_count))
    surfaces = tuple(replace(s, name=ATTACK) for s in plan.terrain.surfaces)
    return replace(
        plan,
        name=ATTACK,
        robot=replace(plan.robot, limb_names=names, name=ATTACK),
        terrain=replace(plan.terrain, surfaces=surfaces),
        warnings=(ATTACK,),
        solvers={ATTACK: ATTACK},
        timings={ATTACK: 1.0},
        sizes={ATTACK: {ATTACK: ATTACK}},
        climbplan_version=ATTACK,
        created=ATTACK,
        spec_text=plan.spec_text + f"# {ATTACK}</pre></script>\n",
    )


@pytest.fixture(scope="module")
def pages(make_plan: MakePlan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Reports of four plans."""
    grid = np.array([0.0, 10.0, 20.0]), np.array([0.5, 1.0])
    keys = ("terrain.walls.angle_deg", "terrain.friction")
    study = Study(keys, grid, np.array([[1, 0], [1, 0], [2, 2]]), (ATTACK,) * 6)
    beam = {"name": "beam", "lower": [-0.615, 0.4, 0.3], "upper": [0.615, 0.9, 0.5]}
    plans = {
        "six": make_plan(6, 3, study=study, terrain={"obstacles": [beam]}),
        "tall": make_plan(8, 32, goal=(0.0, 0.0, 3.2)),
        "tube": make_plan(6, 2, terrain={"tube": {"radius": 0.62, "up": [-1, 2]}}),
        "hostile": hostile(make_plan(3, 1, title=ATTACK, study=study)),
    }
    found = {}
    for name, plan in plans.items():
        directory = tmp_path_factory.mktemp(name)
        write_climb(plan, directory / "plan.h5")
        report = build_report(directory / "plan.h5")
        found[name] = directory / "report.html"
        found[name].write_text(build_page(plan, report, {"Postures": DOT}), encoding="utf-8")
    return found


@pytest.mark.parametrize("name", ["six", "tall", "tube", "hostile"])
def test_nothing_is_fetched_from_anywhere(pages: dict[str, Path], name: str) -> None:
    page = Page(pages[name].read_text(encoding="utf-8"))
    for tag, attributes in page.tags:
        for key in ("src", "href", "srcset", "action", "data", "poster", "background"):
            value = attributes.get(key)
            assert value is None or value.startswith(("#", "data:")), (tag, key, value)
        assert not [key for key in attributes if key.startswith("on")], (tag, attributes)
    assert "@import" not in page.texts["style"]
    assert "url(" not in page.texts["style"]
    policies = [a["content"] for t, a in page.tags if a.get("http-equiv")]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")
    assert "http" not in policies[0]


def test_size_stays_sensible(pages: dict[str, Path]) -> None:
    sizes = {name: path.stat().st_size / 1e6 for name, path in pages.items()}
    assert sizes["six"] < 6.5, sizes
    assert sizes["tall"] < 9.0, sizes


def test_names_never_become_markup(pages: dict[str, Path]) -> None:
    page = Page(pages["hostile"].read_text(encoding="utf-8"))
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert scripts == [{"type": "application/json", "id": "plan-data"}, {}, {}]
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    assert [image["alt"] for image in images] == ["Postures"]
    assert ATTACK in page.texts["h1"]
    assert ATTACK in page.texts["pre"]


def test_data_holds_every_instant_of_every_limb(pages: dict[str, Path]) -> None:
    text = pages["six"].read_text(encoding="utf-8")
    start = text.index('id="plan-data">') + len('id="plan-data">')
    data = json.loads(text[start : text.index("</script>", start)])
    assert [limb["name"] for limb in data["limbs"]] == ["RF", "RM", "RR", "LR", "LM", "LF"]
    assert len(data["instants"]["label"]) == 36
    assert len(data["instants"]["force"]) == 36 * 6 * 3
    frames = len(data["replay"]["time"])
    assert len(data["replay"]["joints"]) == frames * 6 * 9
    assert len(data["replay"]["contact"]) == len(data["replay"]["instant"]) == frames
    assert data["study"]["axes"][0]["own"] == 0.0


PROGRAM = chromium_path()
needs_browser = pytest.mark.skipif(PROGRAM is None, reason="no Chromium found: page not run")


@pytest.fixture
def browser() -> Iterator[Browser]:
    assert PROGRAM is not None
    with Browser(PROGRAM) as one:
        yield one


SPILLING = """[...document.querySelectorAll('.chart')].filter((c) =>
  c.querySelector('.main-svg').getBoundingClientRect().width > c.clientWidth + 1).length"""


def settled(browser: Browser, page: Path) -> None:
    """Open a page and wait for its last chart."""
    browser.open(page)
    browser.wait_for("document.querySelectorAll('#friction-charts .main-svg').length > 0")


CLOCK = "parseFloat(document.getElementById('clock').textContent)"
PIXELS = """(() => {
  const c = document.getElementById('%s');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  return d.reduce((n, v, i) => n + (i %% 4 === 3 && v > 0), 0);
})()"""


@needs_browser
def test_the_page_is_quiet_and_the_replay_advances(
    pages: dict[str, Path], browser: Browser
) -> None:
    settled(browser, pages["six"])
    assert browser.evaluate("document.querySelectorAll('.chart .main-svg').length") > 0
    assert browser.evaluate("document.querySelectorAll('.chart').length") == 2 + 2 * 6
    assert browser.evaluate(SPILLING) == 0
    for canvas in ("replay-view", "forces-view"):
        assert browser.evaluate(PIXELS % canvas) > 10_000
    assert browser.evaluate(CLOCK) == 0
    before = browser.evaluate("document.getElementById('replay-view').toDataURL()")
    browser.evaluate("document.getElementById('play').click()")
    browser.wait_for(f"{CLOCK} > 2")
    assert browser.evaluate("document.getElementById('replay-phase').textContent") != ""
    assert browser.evaluate("document.getElementById('replay-view').toDataURL()") != before
    browser.evaluate("document.getElementById('play').click()")
    stopped = browser.evaluate(CLOCK)
    browser.wait_for("document.getElementById('play').textContent === 'Play'")
    assert browser.evaluate(CLOCK) == stopped
    assert browser.console == []
    assert [r for r in browser.requests if not r.startswith("data:")] == [pages["six"].as_uri()]


@needs_browser
def test_the_replay_ends_and_starts_again(pages: dict[str, Path], browser: Browser) -> None:
    settled(browser, pages["tube"])
    end = browser.evaluate("Number(document.getElementById('time').max)")
    browser.evaluate(
        f"const t = document.getElementById('time'); t.value = {end - 0.5};"
        "t.dispatchEvent(new Event('input'));"
        "document.getElementById('speed').value = '60';"
        "document.getElementById('play').click()"
    )
    browser.wait_for("document.getElementById('play').textContent === 'Play'")
    assert browser.evaluate(CLOCK) == pytest.approx(end, abs=0.06)
    assert "push 6" in browser.evaluate("document.getElementById('replay-phase').textContent")
    browser.evaluate("document.getElementById('play').click()")
    assert browser.evaluate("document.getElementById('play').textContent") == "Pause"
    browser.wait_for(f"{CLOCK} < {end / 2}")
    assert browser.console == []


@needs_browser
def test_forces_follow_the_chosen_instant(pages: dict[str, Path], browser: Browser) -> None:
    settled(browser, pages["six"])
    rows = "[...document.querySelectorAll('#force-rows tr')].map((r) => r.textContent)"
    browser.evaluate("panelPick = (k) => { const i = document.getElementById('instant');"
                     "i.value = k; i.dispatchEvent(new Event('input')); }")  # fmt: skip
    browser.evaluate("panelPick(0)")
    assert browser.evaluate("document.getElementById('instant-label').textContent") == (
        "1: round 1, RF lifted"
    )
    lifted = browser.evaluate(rows)
    assert len(lifted) == 6
    assert lifted[0] == "RFlifted"
    browser.evaluate("document.getElementById('next').click()")
    assert browser.evaluate("document.getElementById('instant-label').textContent") == (
        "2: round 1, push 1"
    )
    assert "lifted" not in "".join(browser.evaluate(rows))
    # A click on a chart goes to that instant.
    browser.evaluate("document.querySelector('#torque-charts .chart')"
                     ".emit('plotly_click', {points: [{x: 14}]})")  # fmt: skip
    assert browser.evaluate("document.getElementById('instant').value") == "14"
    assert browser.console == []


@needs_browser
def test_names_run_nothing_in_a_browser(pages: dict[str, Path], browser: Browser) -> None:
    browser.emulate(width=390, height=844, phone=True)
    settled(browser, pages["hostile"])
    browser.wait_for("document.querySelectorAll('#study-chart .main-svg').length > 0")
    assert browser.evaluate("window.broken === undefined")
    legend = browser.evaluate("document.getElementById('limb-legend').textContent")
    assert ATTACK in legend
    assert browser.evaluate("document.querySelectorAll('img').length") == 1
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    assert browser.evaluate(SPILLING) == 0
    assert browser.console == []


@needs_browser
def test_the_page_fits_its_window(pages: dict[str, Path], browser: Browser) -> None:
    settled(browser, pages["tall"])
    assert browser.evaluate(SPILLING) == 0
    overflow = "document.documentElement.scrollWidth > innerWidth"
    paper = "getComputedStyle(document.body).backgroundColor"
    for width, dark in ((1280, False), (768, True), (390, False)):
        browser.emulate(width=width, height=844, phone=width == 390, dark=dark)
        browser.wait_for(f"innerWidth === {width} && !({overflow})", 5)
        shown = "rgb(18, 23, 29)" if dark else "rgb(255, 255, 255)"
        browser.wait_for(f"{paper} === '{shown}'", 5)
        browser.wait_for(f"{SPILLING} === 0", 5)
    assert browser.console == []


@needs_browser
def test_charts_of_few_instants_show_them_all(pages: dict[str, Path], browser: Browser) -> None:
    settled(browser, pages["six"])
    above = """[...document.querySelectorAll('#safety-charts .chart')].map((c) =>
      c.data[2].y.filter((v) => v > c.layout.yaxis.range[1]).length)"""
    assert browser.evaluate(above) == [0, 0]


@needs_browser
def test_a_dark_page_prints_in_the_colours_of_paper(
    pages: dict[str, Path], browser: Browser
) -> None:
    browser.emulate(width=1280, height=900, dark=True)
    settled(browser, pages["six"])
    ink = "getComputedStyle(document.documentElement).getPropertyValue('--ink').trim()"
    axis = "document.querySelector('.chart').layout.font.color"
    drawn = "getComputedStyle(document.querySelector('img.drawn')).filter"
    assert browser.evaluate(axis) == browser.evaluate(ink) == "#e6ebf1"
    assert browser.evaluate(drawn).startswith("invert")
    browser.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert browser.evaluate(axis) == browser.evaluate(ink) == "#1f2933"
    browser.evaluate("dispatchEvent(new Event('afterprint'))")
    assert browser.evaluate(axis) == "#e6ebf1"
    browser.emulate(width=1280, height=900, dark=True, paper=True)
    assert browser.evaluate(drawn) == "none"


@needs_browser
def test_the_page_fits_on_paper(pages: dict[str, Path], browser: Browser, tmp_path: Path) -> None:
    """A4 without its margins is 688 pixels wide: charts two abreast, words in every column."""
    browser.emulate(width=1280, height=900)
    settled(browser, pages["tall"])
    browser.emulate(width=688, height=1017, paper=True)
    browser.evaluate(
        "dispatchEvent(new Event('resize'))"
    )  # which a window without a screen may lack
    browser.wait_for("document.documentElement.scrollWidth <= 688")  # charts follow a moment later
    edges = "(e) => Math.round(e.getBoundingClientRect().left)"
    columns = f"new Set([...document.querySelectorAll('#torque-charts > div')].map({edges})).size"
    assert browser.evaluate(columns) == 2
    spilling = """[...document.querySelectorAll('#torque-charts .main-svg')].filter((s) =>
      s.getBoundingClientRect().right > 689).length"""
    assert browser.evaluate(spilling) == 0
    widths = "[...document.querySelectorAll('.checks thead th')].map((c) => c.clientWidth)"
    assert min(browser.evaluate(widths)) > 55
    broken = "[...document.querySelectorAll('%s')].filter((e) => getComputedStyle(e).breakInside"
    for kept in (".charts > div", "tr", "figure", ".note"):
        assert browser.evaluate(f"{broken % kept} !== 'avoid').length") == 0
    browser.print_pdf(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


@needs_browser
def test_checks_are_read_on_a_phone(pages: dict[str, Path], browser: Browser) -> None:
    browser.emulate(width=390, height=844, phone=True)
    settled(browser, pages["six"])
    heights = "[...document.querySelectorAll('.checks tr')].map((r) => r.clientHeight)"
    assert max(browser.evaluate(heights)) < 180  # no column of single letters
    lost = """[...document.querySelectorAll('.checks td')].filter((c) =>
      c.textContent && c.getBoundingClientRect().right > innerWidth).length"""
    assert browser.evaluate(lost) == 0
