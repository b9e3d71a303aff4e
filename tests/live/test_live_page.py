"""The live page in Chromium: completion, mistakes as one types, a plan, and its replay."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from headless_chromium import Browser, chromium_path
from test_live_server import SMALL, serving

from climbplan.live.server import LiveServer

pytestmark = pytest.mark.skipif(chromium_path() is None, reason="no Chromium found: page not run")

# A spec with the cursor at |, a completion that is offered there, and one that is not
COMPLETIONS = [
    ("kind: cli|", "climb", "bookshelf_scene"),
    ("kind: climb\nter|", "terrain", "robot"),
    ("kind: climb\nrobot: silvia\nterrain:\n  |", "walls", "rounds"),
    ("kind: climb\nterrain:\n  walls:\n    gap: 1\n    |", "along", "gap"),
    ("kind: climb\nterrain:\n  boxes:\n    - name: a\n      |", "lower", "name"),
    ("kind: climb\nterrain:\n  boxes:\n  - name: a\n    |", "lower", "name"),
    ("kind: climb\nterrain:\n  boxes:\n    - name: a\n    - |", "upper", "boxes"),
    ("kind: climb\ntask:\n  goal: {|", "com", "rounds"),
    ("kind: climb\ntask:\n  goal: {com: [0, 0, 1], |", "tolerance", "com"),
    ("kind: climb\nsolver:\n  method: |", "micp", "climb"),
    (
        "kind: climb\ntask:\n  start: {com: [0, 0, 0]}\n  |\nforce:\n  safety_torque: 1",
        "gait",
        "sag",
    ),
]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with serving(tmp_path_factory.mktemp("page")) as server:
        yield server


@pytest.fixture(scope="module")
def browser(live: LiveServer) -> Iterator[Browser]:
    program = chromium_path()
    assert program is not None
    with Browser(program) as page:
        page.visit(live.address)
        page.wait_for("!!document.querySelector('#mistakes .good')")
        yield page


@pytest.mark.parametrize(("text", "offered", "other"), COMPLETIONS)
def test_completion_offers_what_the_schema_has_there(
    browser: Browser, text: str, offered: str, other: str
) -> None:
    cursor = text.index("|")
    browser.evaluate(f"schemaOf({json.dumps(text.replace('|', ''))})")
    browser.wait_for("schemas.size === 0 || [...schemas.values()].every((one) => one)")
    found = browser.evaluate(
        f"completionsAt({json.dumps(text.replace('|', ''))}, {cursor}, "
        f"schemaOf({json.dumps(text.replace('|', ''))})).entries.map((entry) => entry.label)"
    )
    assert offered in found
    assert other not in found


def test_mistakes_appear_as_one_types(browser: Browser) -> None:
    browser.evaluate(f"setSpec({json.dumps(SMALL.replace('insert:', 'insrt:'))})")
    browser.wait_for("!!document.querySelector('#mistakes button')")
    assert "insrt" in browser.evaluate("document.querySelector('#mistakes button').textContent")
    assert browser.evaluate("document.querySelectorAll('#gutter .wrong').length") == 1
    browser.evaluate("document.querySelector('#mistakes button').click()")
    selected = browser.evaluate("spec.value.slice(spec.selectionStart, spec.selectionEnd)")
    assert "insrt:" in selected


def test_a_completion_is_chosen_by_key(browser: Browser) -> None:
    browser.evaluate("setSpec('kind: bookshelf\\n')")
    browser.wait_for("!!schemaOf(spec.value)")
    was_open = browser.evaluate(
        "spec.focus(); spec.setSelectionRange(16, 16); spec.setRangeText('sol', 16, 16, 'end'); "
        "offerCompletions(); const wasOpen = !popup.hidden; "
        "spec.dispatchEvent(new KeyboardEvent('keydown', {key: 'Tab', cancelable: true})); wasOpen"
    )
    assert was_open
    assert browser.evaluate("spec.value").startswith("kind: bookshelf\nsolver:")
    assert browser.evaluate("popup.hidden")


def test_a_plan_is_shown_with_checks_and_replay(browser: Browser, tmp_path: Path) -> None:
    browser.evaluate(f"setSpec({json.dumps(SMALL)}); el('quick').checked = true; startPlan()")
    browser.wait_for("runs.some((run) => run.complete) && running === null", 120)
    browser.wait_for("!!document.querySelector('#outcome .checks')")
    assert browser.evaluate("document.querySelectorAll('#replays iframe').length") == 1
    browser.emulate(width=390, height=844, phone=True, dark=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    browser.evaluate("scrollTo(0, 0); finish(runs.at(-1))")  # there the plan is below the editor
    browser.wait_for("scrollY > 0")
    browser.picture(tmp_path / "phone.png")
    assert (tmp_path / "phone.png").stat().st_size > 10_000
    assert browser.console == []
    own = browser.evaluate("location.origin")
    foreign = [url for url in browser.requests if not url.startswith((own, "data:", "about:"))]
    assert foreign == []
