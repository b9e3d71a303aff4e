"""Films of plans, read back with what did not write them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from climbplan.api.kinds import identify_kind
from climbplan.cli.app import run
from climbplan.errors import MissingSolver, UsageError
from climbplan.exports.film import LONGEST, check_film, schedule_frames, write_film
from climbplan.exports.film_frames import HEIGHT, WIDTH, Frames
from climbplan.reports.viewer.scene import ViewerScene

WALL = 255 - 60  # [0 ... 255] what is darker is no sky


@pytest.fixture(scope="module")
def scenes(plans: dict[str, Path]) -> dict[str, ViewerScene]:
    found = {name: identify_kind(path).read_scene(path) for name, path in plans.items()}
    try:
        Frames(found["walk"]).__exit__(None, None, None)
    except MissingSolver as error:
        pytest.skip(str(error))
    return found


def test_long_spans_are_played_faster_and_short_ones_are_not() -> None:
    ends, rate = np.array([0.0, 40.0]), 25.0
    times = schedule_frames(ends, np.array([37.5, 38.5]), rate)
    assert len(times) == pytest.approx(LONGEST * rate, abs=1)
    assert times[0] == 0.0
    assert times[-1] == 40.0
    step = np.diff(times)
    assert (step >= 0).all()
    assert step[times[:-1] > 37.6] == pytest.approx(1 / rate, rel=0.02)  # as time goes by
    assert step[times[1:] < 37.4] == pytest.approx(37.5 / (LONGEST - 2.5) / rate, rel=0.02)
    # A short plan takes what it takes, marks or not
    assert np.diff(
        schedule_frames(np.array([1.0, 3.0]), np.array([1.5, 9.0]), rate)
    ) == pytest.approx(1 / rate, rel=0.03)


@pytest.mark.parametrize("name", ["climb", "walk", "modules"])
def test_pictures_show_what_moves(scenes: dict[str, ViewerScene], name: str) -> None:
    scene = scenes[name]
    with Frames(scene, "verified") as frames:
        first, last, again = (frames.render_at(scene.time[k]) for k in (0, -1, 0))
    assert first.shape == (HEIGHT, WIDTH, 3)
    assert np.array_equal(first, again)  # a picture says its time, not what was drawn before
    inner = slice(100, HEIGHT - 60)
    assert (np.abs(first[inner].astype(int) - last[inner]).max(axis=2) > 40).mean() > 0.005
    assert (last[inner].max(axis=2) < WALL).mean() > 0.03
    # Words stand above and below
    assert (first[:60].max(axis=2) < 90).sum() > 100
    assert (first[-50:].max(axis=2) < 90).sum() > 100


def test_a_front_wall_hides_nothing(scenes: dict[str, ViewerScene]) -> None:
    scene = scenes["modules"]
    toward = np.deg2rad(scene.azimuth_deg)
    front = scene.shapes[0]
    away = 5.0 * np.array([np.cos(toward), np.sin(toward), 0.0])
    black = replace(front, vertices=front.vertices + away, color="#000000", opacity=1.0)
    with Frames(scene) as one, Frames(replace(scene, shapes=(*scene.shapes, black))) as two:
        assert np.array_equal(one.render_at(0.0), two.render_at(0.0))


def test_a_gif_and_its_still(
    plans: dict[str, Path], scenes: dict[str, ViewerScene], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    film = tmp_path / "walk.gif"
    page = str(tmp_path / "page")
    assert run(["report", str(plans["walk"]), "-o", page, "--film", str(film)]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == [f"{page}/report.html", str(film)]
    span = float(np.ptp(scenes["walk"].time))
    with Image.open(film) as read:
        assert read.size == (WIDTH, HEIGHT)
        assert read.n_frames == max(2, round(span * 12.5))
        assert read.info["loop"] == 0
        pictures = []
        for frame in range(read.n_frames):
            read.seek(frame)
            pictures.append(np.asarray(read.convert("RGB")))
    assert not np.array_equal(pictures[0], pictures[-1])
    with Image.open(film.with_suffix(".png")) as still:
        assert still.size == (WIDTH, HEIGHT)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page", "walk.gif", "walk.png"]
    before = film.read_bytes()
    assert run(["report", str(plans["walk"]), "-o", page, "--film", str(film)]) == 2
    assert "already exists; --force replaces it" in capsys.readouterr().err
    assert film.read_bytes() == before


def test_an_mp4_is_read_by_its_decoder(scenes: dict[str, ViewerScene], tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film = tmp_path / "walk.mp4"
    done: list[float] = []
    write_film(scenes["walk"], film, progress=done.append)
    assert done[-1] == 1.0
    assert done == sorted(done)
    decoder = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(film)]
    raw = subprocess.run([*decoder, "-f", "rawvideo", "-pix_fmt", "gray", "-"], capture_output=True)
    assert raw.stderr == b""
    pictures = np.frombuffer(raw.stdout, np.uint8).reshape(-1, HEIGHT, WIDTH)
    assert len(pictures) >= round(25 * float(np.ptp(scenes["walk"].time)))
    assert (np.abs(pictures[0].astype(int) - pictures[-1]) > 40).mean() > 0.005


def test_what_cannot_be_filmed(scenes: dict[str, ViewerScene], tmp_path: Path) -> None:
    walk = scenes["walk"]
    with pytest.raises(UsageError, match=r"ends in \.gif, \.webp or \.mp4"):
        write_film(walk, tmp_path / "walk.avi")
    with pytest.raises(UsageError, match="a directory that exists"):
        write_film(walk, tmp_path / "nowhere" / "walk.gif")
    with pytest.raises(UsageError, match="nothing in it moves"):
        write_film(replace(walk, time=walk.time * 0.0), tmp_path / "walk.gif")
    assert not list(tmp_path.iterdir())


def test_a_missing_encoder_is_named(
    scenes: dict[str, ViewerScene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingSolver, match=r"pip install 'climbplan\[film\]'"):
        write_film(scenes["walk"], tmp_path / "walk.mp4")
    with pytest.raises(MissingSolver, match="MP4 needs an encoder"):
        check_film(tmp_path / "walk.mp4")
    check_film(tmp_path / "walk.gif")


def test_a_film_without_mujoco_names_the_extra_for_films(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingSolver, match=r"a film needs MuJoCo.*climbplan\[film\]"):
        check_film(tmp_path / "walk.gif")
    with pytest.raises(UsageError, match=r"\.avi"):
        check_film(tmp_path / "walk.avi")
