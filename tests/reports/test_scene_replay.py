"""Replays of walks and modules, and axes of time that begin where something happens."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from headless_chromium import Browser, chromium_path
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from scenes import PlannedScenes

from climbplan.limms.pages.figure_modes import plot_modes
from climbplan.limms.pages.scene import build_module_scene
from climbplan.limms.pages.scene import read_scene as limms_scene
from climbplan.limms.pages.time_axis import TimeScale
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports.palette import choose_ink
from climbplan.reports.scene_replay import build_scene_replay, find_start_time
from climbplan.reports.viewer.scene import build_block, build_polygons, compute_outline
from climbplan.walking.pages.scene import read_scene as walk_scene


@pytest.fixture(scope="session")
def folders(planned_scenes: PlannedScenes) -> dict[str, Path]:
    """A walk and a throw, with their pages."""
    return {"walk": planned_scenes["walk"].parent, "throw": planned_scenes["modules"].parent}


def replay_of(page: Path) -> dict[str, Any]:
    text = (page / "report.html").read_text(encoding="utf-8")
    start = text.index('id="replay-data">') + len('id="replay-data">')
    found: dict[str, Any] = json.loads(text[start : text.index("</script>", start)])
    return found


def later(plan: LimmsPlan, seconds: float) -> LimmsPlan:
    """The same motion after some time in which nothing moves."""
    time = plan.motion.time.copy()
    time[1:] += seconds
    stages = tuple((name, begin + seconds, end + seconds) for name, begin, end in plan.stages)
    return replace(plan, motion=replace(plan.motion, time=time), stages=stages)


def test_pages_hold_every_sample_of_their_scene(folders: dict[str, Path]) -> None:
    walk = walk_scene(folders["walk"] / "plan.h5")
    data = replay_of(folders["walk"])
    assert walk.rods is not None
    assert walk.forces is not None
    assert np.allclose(data["time"], walk.time, atol=1e-4)
    assert np.allclose(data["rods"]["ends"], walk.rods.ends, atol=1e-4)
    assert data["start"] == walk.time[0] or data["start"] < walk.time[-1]
    arrows, force = np.array(data["forces"]["arrow"]), walk.forces.force
    # Along the force, and as long as it is large
    pushes = np.linalg.norm(force, axis=-1) > 1
    assert pushes.any()
    ratio = np.linalg.norm(arrows[pushes], axis=-1) / np.linalg.norm(force[pushes], axis=-1)
    assert np.ptp(ratio) < 0.02 * ratio.mean()
    assert (np.sum(arrows[pushes] * force[pushes], axis=-1) > 0).all()
    throw = limms_scene(folders["throw"] / "plan.h5")
    assert replay_of(folders["throw"]) == json.loads(json.dumps(build_scene_replay(throw)))


def test_modules_are_shown_from_shortly_before_the_box_moves(folders: dict[str, Path]) -> None:
    plan = read_limms_plan(folders["throw"] / "plan.h5")
    here, waited = (build_module_scene(one) for one in (plan, later(plan, 60.0)))
    assert find_start_time(waited) == pytest.approx(find_start_time(here) + 60.0, abs=0.2)
    assert find_start_time(replace(here, boxes=None)) == here.time[0]
    box = plan.motion.box_position[:, 0]
    start = np.interp(find_start_time(here) + 1.0, plan.motion.time, box[:, 2])
    assert abs(start - box[0, 2]) < 0.02


def test_long_driving_is_pressed_together(folders: dict[str, Path]) -> None:
    plan = read_limms_plan(folders["throw"] / "plan.h5")
    waited = later(plan, 60.0)
    scale = TimeScale(waited)
    compressed = scale.motion_start - scale.start
    assert scale.label == f"time [s]; the first {compressed:.1f} s pressed together"
    assert scale.motion_start > 60.0
    places = scale.map_times(np.array([scale.start, scale.motion_start, scale.end]))
    assert places == pytest.approx([0.0, 0.2, 1.0])
    times = np.linspace(-5.0, 80.0, 41)
    assert scale._time_at(scale.map_times(times)) == pytest.approx(times)
    figure = plot_modes(waited)
    assert [panel.get_xscale() for panel in figure.axes[:2]] == ["function", "function"]
    assert figure.axes[1].get_xlabel() == scale.label


def test_text_on_bars_is_seen(folders: dict[str, Path]) -> None:
    figure: Figure = plot_modes(read_limms_plan(folders["throw"] / "plan.h5"))
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    assert texts
    for text in texts:
        middle = text.get_position()
        (bar,) = (
            patch
            for patch in figure.axes[0].patches
            if patch.get_x() <= middle[0] <= patch.get_x() + patch.get_width()  # type: ignore[attr-defined]
            and abs(patch.get_y() + patch.get_height() / 2 - middle[1]) < 0.1  # type: ignore[attr-defined]
        )
        assert to_hex(text.get_color()).upper() == choose_ink(to_hex(bar.get_facecolor()))
    assert choose_ink("#0072B2") == "#FFFFFF"
    assert choose_ink("#F0B48A") != "#FFFFFF"


def test_outlines_are_edges_that_are_seen() -> None:
    cube = build_block("cube", np.zeros(3), np.ones(3), "#000000", 1.0)
    edges = cube.vertices[compute_outline(cube)]
    assert len(edges) == 12
    assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1) == pytest.approx(1.0)
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    assert len(compute_outline(build_polygons("square", [square], "#000000", 1.0))) == 4


PIXELS = """(() => {
  const c = document.getElementById('replay');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  return d.reduce((n, v, i) => n + (i % 4 === 3 && v > 0), 0);
})()"""


@pytest.mark.skipif(chromium_path() is None, reason="no Chromium found: page not run")
@pytest.mark.parametrize("name", ["walk", "throw"])
def test_replays_are_drawn_and_advance(folders: dict[str, Path], name: str) -> None:
    program = chromium_path()
    assert program is not None
    with Browser(program) as browser:
        browser.open(folders[name] / "report.html")
        browser.wait_for(f"{PIXELS} > 10_000")
        assert browser.evaluate("document.getElementById('replay-label').textContent") != ""
        before = browser.evaluate("document.getElementById('replay').toDataURL()")
        browser.evaluate("document.getElementById('replay-play').click()")
        browser.wait_for(
            "Number(document.getElementById('replay-time').value) > "
            f"{replay_of(folders[name])['start'] + 0.1}"
        )
        assert browser.evaluate("document.getElementById('replay').toDataURL()") != before


@pytest.mark.skipif(chromium_path() is None, reason="no Chromium found: page not run")
def test_replays_play_slowly_and_again_from_the_start(folders: dict[str, Path]) -> None:
    program = chromium_path()
    assert program is not None
    start = replay_of(folders["walk"])["start"]
    with Browser(program) as browser:
        browser.open(folders["walk"] / "report.html")
        browser.wait_for(f"{PIXELS} > 10_000")
        # A thousand frames of 1 ms at a tenth of the speed: far less than a pixel each
        passed = browser.evaluate(
            "speed.value = '0.1'; playing = true; before = 0;"
            "for (let k = 1; k <= 1000; k += 1) tick(k);"
            "playing = false; time"
        )
        assert passed == pytest.approx(start + 0.1, abs=1e-6)
        ended = browser.evaluate(
            "goTo(last - 1e-4); playing = true; before = 0; tick(1000);"
            "[playing, time === last, Number(slider.value) === last]"
        )
        assert ended == [False, True, True]
        again = browser.evaluate("button.click(); playing = false; time")
        assert again == start
        # A finger on the picture may still scroll the page
        assert browser.evaluate("getComputedStyle(canvas).touchAction") == "pan-y"
