"""The 3-D view: scenes of climbs and shelves, what the server draws, and the page in a browser."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from headless_chromium import Browser, chromium_path

from climbplan.bookshelf.pages.scene import read_scene as shelf_scene
from climbplan.bookshelf.plan.file import write_shelf_plan
from climbplan.bookshelf.planner.runs import run_shelf
from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.climb.pages.scene import read_scene as climb_scene
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.errors import UsageError
from climbplan.reports.viewer.scene import ViewerScene, build_polygons, interpolate

pytest.importorskip("viser", reason="no viser found: the 3-D view is not tested")
from climbplan.reports.viewer.server import Viewer  # (after the check that it can be had)
from climbplan.reports.viewer.stage import _align_z_to, map_load_to_color, parse_rgb

MakePlan = Callable[..., ClimbPlan]
SPECS = Path(__file__).parents[2] / "specs"
ATTACK = "{window.broken = 1}<img src=x onerror='window.broken=1'>\n\nimport 'x'"


@pytest.fixture(scope="module")
def plan(make_plan: MakePlan) -> ClimbPlan:
    return make_plan(6, 3, name="climb_viewed")


@pytest.fixture(scope="module")
def climb_file(plan: ClimbPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "plan.h5"
    write_climb(plan, path)
    return path


@pytest.fixture(scope="module")
def climb(climb_file: Path) -> ViewerScene:
    return climb_scene(climb_file)


def test_links_keep_their_lengths_and_toes_stand_where_they_push(
    plan: ClimbPlan, climb: ViewerScene
) -> None:
    assert climb.rods is not None
    assert climb.forces is not None
    limbs = climb.rods.ends[:, :18].reshape(-1, 6, 3, 2, 3)
    lengths = np.linalg.norm(limbs[..., 1, :] - limbs[..., 0, :], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(plan.robot.link_lengths, lengths.shape))
    np.testing.assert_allclose(limbs[:, :, 2, 1], climb.forces.point)
    pushing = np.linalg.norm(climb.forces.force, axis=-1) > 0
    on_wall = np.abs(np.abs(climb.forces.point[..., 0][pushing]) - 0.615)
    assert np.median(on_wall) < 1e-6


def test_forces_of_every_instant_are_shown_once(plan: ClimbPlan, climb: ViewerScene) -> None:
    assert climb.forces is not None
    assert len(climb.marks) == plan.instants.count
    np.testing.assert_array_equal(climb.forces.force[climb.marks], plan.forces.force)
    texts = [climb.caption[k] for k in climb.marks]
    assert len(set(texts)) == plan.instants.count
    assert climb.caption[0] == "before the first lift"
    assert all("S_tau" in text and "S_mu" in text for text in texts)


def test_loads_are_shares_of_the_limits(plan: ClimbPlan, climb: ViewerScene) -> None:
    assert climb.rods is not None
    assert climb.rods.load is not None
    shares = climb.rods.load[climb.marks].max(axis=1)
    np.testing.assert_allclose(1 / shares, plan.forces.safety_torque)


def test_moments_at_before_and_after() -> None:
    nothing = ViewerScene(
        "", (), np.array([0.0, 1.0, 1.0, 3.0]), ("a", "b", "c", "d"), np.array([0])
    )
    assert nothing.moment(-5.0) == (0, 1, 0.0)
    assert nothing.moment(0.25) == (0, 1, 0.25)
    assert nothing.moment(1.0) == (2, 3, 0.0)  # a jump: what comes after it
    assert nothing.moment(9.0) == (3, 3, 0.0)
    values = np.array([0.0, 4.0, 8.0, 10.0])
    assert interpolate(values, nothing.moment(2.0)) == 9.0


def test_fans_cover_polygons() -> None:
    square = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], float)
    shape = build_polygons("two", [square, square[:3] + 5.0], "#000000", 1.0)
    corners = shape.vertices[shape.faces]
    assert shape.faces.shape == (3, 3)
    each = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert each.sum() / 2 == pytest.approx(4.0 + 2.0)


def test_z_is_turned_to_any_direction() -> None:
    rng = np.random.default_rng(0)
    directions = np.vstack([rng.normal(size=(20, 3)), np.eye(3), -np.eye(3), np.zeros(3)])
    w, x, y, z = _align_z_to(directions).T
    third = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)])
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    wanted = np.where(length > 0, directions / np.maximum(length, 1e-9), [0, 0, 1])
    np.testing.assert_allclose(third, wanted, atol=1e-12)


def test_load_colours_from_green_to_red() -> None:
    green, yellow, red, more = map_load_to_color(np.array([0.0, 0.5, 1.0, 7.0]))
    assert green[1] > green[0]
    assert min(yellow[:2]) > 150
    assert red[0] > red[1]
    np.testing.assert_array_equal(red, more)
    assert parse_rgb("#0a10ff") == (10, 16, 255)


def test_books_come_from_where_they_were(tmp_path: Path) -> None:
    solved = run_shelf(load_shelf(SPECS / "bookshelf_file.yaml"))
    found = solved.solutions
    lost = replace(
        found,
        pose=np.where(np.arange(40)[:, None, None] == 2, np.nan, found.pose),
        status=tuple("infeasible" if k == 2 else s for k, s in enumerate(found.status)),
        message=tuple("3 mm missing" if k == 2 else "" for k in range(40)),
    )
    write_shelf_plan(replace(solved, solutions=lost), tmp_path / "plan.h5")
    scene = shelf_scene(tmp_path / "plan.h5")
    assert scene.boxes is not None
    first, last = scene.marks, scene.marks + 4
    stored = scene.boxes.center[first][:, :-1, [0, 2]]
    np.testing.assert_array_equal(stored, solved.scenes.pose[..., :2])
    there = np.delete(np.arange(40), 2)
    np.testing.assert_array_equal(
        scene.boxes.center[last][there][..., [0, 2]], found.pose[there][..., :2]
    )
    tilted = scene.boxes.rotation[last][there] @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(tilted[..., 0], -np.sin(found.pose[there][..., 2]), atol=1e-12)
    assert (scene.boxes.size[last[2], -1] == 0).all()  # without a place it is not shown
    assert scene.caption[first[2]] == "scene 2: infeasible, 3 mm missing"


def test_server_follows_time_and_switches(climb: ViewerScene) -> None:
    with Viewer(climb, "127.0.0.1", 0) as viewer:
        with urllib.request.urlopen(f"http://127.0.0.1:{viewer.port}", timeout=10) as page:
            assert b"<html" in page.read()
        rods = viewer._stage._moving["rods"]
        before = np.array(rods.batched_positions)
        viewer._go("last")
        moved = np.linalg.norm(np.array(rods.batched_positions) - before, axis=1)
        assert moved.max() > 0.2
        assert viewer._time.value == pytest.approx(climb.time[-1], abs=1e-3)
        limbs = np.array(rods.batched_colors)
        viewer._color_loads(True)
        assert (np.array(rods.batched_colors) != limbs).any()
        viewer._switch("forces", False)
        assert not viewer._stage._moving["forces"].visible
        viewer._go("first")
        viewer._go("next")
        assert viewer._stop("back") == climb.time[0]
        viewer._advance(1e6)
        assert viewer._time.value == climb.time[0]  # from the end it starts again


def test_a_port_that_cannot_be_had(climb: ViewerScene) -> None:
    with pytest.raises(UsageError, match=r"--host 203\.0\.113\.7 --port 0: .*assign"):
        Viewer(climb, "203.0.113.7", 0)
    with pytest.raises(UsageError, match="--host no such host"):
        Viewer(climb, "no such host", 0)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with Viewer(climb, "127.0.0.1", port) as viewer:
            assert port < viewer.port < port + 50


def test_texts_of_files_stay_texts(make_plan: MakePlan, tmp_path: Path) -> None:
    plan = make_plan(6, 3)
    names = (ATTACK, *plan.robot.limb_names[1:])
    hostile = replace(plan, robot=replace(plan.robot, limb_names=names, name=ATTACK))
    write_climb(hostile, tmp_path / "plan.h5")
    with Viewer(climb_scene(tmp_path / "plan.h5"), "127.0.0.1", 0) as viewer:
        viewer._go("next")
        assert "<img" not in viewer._caption.content
        assert "&lt;img" in viewer._caption.content


@pytest.fixture
def address(climb_file: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "climbplan", "view", str(climb_file)]
    process = subprocess.Popen(
        [*command, "--no-browser", "--port", "0", "--quiet"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Shells start what runs in the background deaf to Ctrl-C, and children inherit it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    yield line.strip()
    process.send_signal(signal.SIGINT)
    try:
        rest, _ = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 0
    assert rest == ""


@pytest.mark.skipif(chromium_path() is None, reason="no Chromium found: the 3-D view is not seen")
def test_page_in_a_browser(address: str, tmp_path: Path) -> None:
    assert re.fullmatch(r"http://localhost:\d+", address)
    program = chromium_path()
    assert program is not None
    with Browser(program, graphics=True) as browser:
        browser.visit(address)
        browser.wait_for("document.querySelector('canvas') !== null", 60)
        browser.wait_for("document.body.innerText.includes('before the first lift')", 60)
        press = "[...document.querySelectorAll('button')].find(b => b.innerText.trim() === 'next')"
        browser.evaluate(f"{press}.click()")
        browser.wait_for("document.body.innerText.includes('round 1')", 30)
        shown = tmp_path / "view.png"
        blue = 0
        for _ in range(40):  # software rendering takes its time
            browser.picture(shown)
            red, green, sky = np.moveaxis(plt.imread(shown)[:, :900, :3], -1, 0)
            blue = int(((sky > red + 0.25) & (sky > green + 0.05)).sum())
            if blue > 300:
                break
        assert blue > 300, "no limb or force in blue is seen"
        assert (np.ptp([red, green, sky], axis=0) > 0.2).sum() > 3000, "few colours"
        assert not [line for line in browser.console if "THREE.Clock" not in line]
        foreign = [r for r in browser.requests if not r.startswith((address, "data:", "blob:"))]
        assert [r for r in foreign if not r.startswith("ws:")] == []
