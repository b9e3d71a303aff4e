"""Make the gallery's pictures: plan every shipped scene, keep a figure, a thumbnail and films.

python docs/make_gallery.py             all of them, some twenty minutes
python docs/make_gallery.py mpc_turn    some
python docs/make_gallery.py --from outputs mpc_turn    of plans that are there already
python docs/make_gallery.py --courses   films of stairs and rubble of the benchmark `courses`
python docs/make_gallery.py --closed-loop    a climb on half the friction, open and closed loop

Thumbnails and films need MuJoCo and EGL or OSMesa, as `climbplan report --film` does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import matplotlib.image
import numpy as np
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent / "_ext"))
from gallery_page import COURSES, FILMS, MAIN_FILM, Scene, scenes
from motion_pictures import END_DURATION, draw_plan, write_card_picture, write_film

import climbplan
from benchmarks.climb.closed_loop import build_conditions
from benchmarks.climb.courses import propose_walkers, write_spec
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.replay import simulate
from climbplan.simulation.pictures import open_camera

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "gallery"
# The figure that shows the motion, by kind: the first of these that was drawn
FIGURES = {
    "climb": ("region.png", "postures.png"),
    "transition": ("postures.png",),
    "mpc": ("snapshots.png",),
    "limms": ("poses.png",),
    "bookshelf": ("scene.png", "gallery_1.png"),
}
# What a still of the plan does not show: thumbnails of these are their figures
DRAWN = ("climb_region", "bookshelf_file", "bookshelf_five", "bookshelf_scene")
MOMENTS = {
    "limms_throw": 0.8,
    "limms_walk": 0.85,
}  # fraction of a plan's time, where the middle shows little
MOST_BYTES = 60_000
WIDTHS = (760, 680, 600, 520, 440, 360)  # [pixels], the widest that fits
COLOURS = 200  # fewer make two limbs one colour
STILL_QUALITY = 60
# The film of both loops
SURPRISED_SCENE, SURPRISE = "climb_patches", "half the friction"
LOOPS_SIZE = (640, 427)  # [pixels]
FRAME_DURATION = 160  # [ms]
FALL_SAMPLES = 20  # of the plan, before the end of a fall, every other of which is shown


def main() -> None:
    """Read the command line, make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="scenes; all if left out")
    parser.add_argument("--from", dest="plans", type=Path, help="folder of plans by scene")
    parser.add_argument("--courses", action="store_true", help="films of `COURSES` alone")
    parser.add_argument("--closed-loop", action="store_true", help="the film of both loops alone")
    parser.add_argument("--no-figures", action="store_true", help="thumbnails and films alone")
    given = parser.parse_args()
    for folder in ("thumbnails", "films"):
        (PICTURES / folder).mkdir(exist_ok=True)
    if given.courses or given.closed_loop:
        (film_courses if given.courses else film_both_loops)()
        return
    for scene in scenes(ROOT / "specs"):
        if not given.names or scene.name in given.names:
            for path in make(scene, given.plans, not given.no_figures):
                size = path.stat().st_size / 1000
                print(f"{path.relative_to(ROOT)} {size:.0f} kB", flush=True)


def make(scene: Scene, plans: Path | None, with_figure: bool) -> list[Path]:
    """Make the pictures of one scene; return their paths."""
    made = []
    with tempfile.TemporaryDirectory() as scratch:
        if plans is None:
            path = climbplan.plan(ROOT / "specs" / f"{scene.name}.yaml").save(
                Path(scratch) / "plan.h5"
            )
        else:
            path = plans / scene.name / "plan.h5"
        if with_figure:
            climbplan.load_plan(path).write_report(scratch)
            figures = Path(scratch) / "figures"
            drawn = next(figures / f for f in FIGURES[scene.kind] if (figures / f).exists())
            made.append(shrink(drawn, PICTURES / f"{scene.name}.png"))
        if scene.name not in DRAWN:
            target = PICTURES / "thumbnails" / f"{scene.name}.webp"
            picture = draw_plan(path, MOMENTS.get(scene.name, 0.5))
            made.append(write_card_picture(picture, target))
        if scene.name in FILMS:
            made += film(scene.name, path)
    return made


def film_courses() -> None:
    """Plan the courses of `COURSES` and make their films."""
    with tempfile.TemporaryDirectory() as scratch:
        walkers = {walker.name: walker for walker in propose_walkers(Path(scratch))}
        for name, (robot, kind, seed) in COURSES.items():
            plan = climbplan.plan(write_spec(walkers[robot], kind, seed, Path(scratch)))
            for path in film(name, plan.save(Path(scratch) / f"{name}.h5")):
                print(f"{path.relative_to(ROOT)} {path.stat().st_size / 1000:.0f} kB", flush=True)


def film_both_loops() -> None:
    """Film a climb on a wall of half the friction, in open loop beside closed loop."""
    plan = plan_climb(load_climb(ROOT / "specs" / f"{SURPRISED_SCENE}.yaml"))
    loops = [build_conditions(plan, SURPRISE, 0, is_closed, 0) for is_closed in (False, True)]
    fall = simulate(plan, loops[0]).samples
    films = []
    for conditions in loops:
        camera = open_camera(plan.trajectory.com)
        if isinstance(camera, str):
            raise SystemExit(camera)
        camera.samples = sorted({*camera.samples, *range(fall - FALL_SAMPLES, fall, 2)})
        simulate(plan, conditions, watch=camera.watch)
        camera.close()
        films.append([Image.fromarray(picture) for _, picture in camera.pictures])
    frames = []
    for number in range(max(map(len, films))):
        pair = [pictures[min(number, len(pictures) - 1)] for pictures in films]
        beside = Image.new("RGB", (pair[0].width + pair[1].width, pair[0].height))
        beside.paste(pair[0], (0, 0))
        beside.paste(pair[1], (pair[0].width, 0))
        frames.append(beside.resize(LOOPS_SIZE))
    target = PICTURES / "films" / "closed_loop_film.webp"
    durations = [FRAME_DURATION] * (len(frames) - 1) + [END_DURATION]
    frames[0].save(
        target, save_all=True, append_images=frames[1:], duration=durations, loop=0,
        quality=STILL_QUALITY, method=6,
    )  # fmt: skip
    print(f"{target.relative_to(ROOT)} {target.stat().st_size / 1000:.0f} kB", flush=True)


def film(name: str, plan: Path) -> tuple[Path, Path]:
    """Make the film of a plan and its still; return their paths."""
    target = PICTURES / "films" / f"{name}_film.webp"
    still = target.with_name(f"{name}_still.webp")
    width, rate = (640, 12.5) if name == MAIN_FILM else (480, 6.25)
    write_film(plan, target, width, rate)
    with Image.open(target) as pictures:
        pictures.seek(getattr(pictures, "n_frames", 1) // 2)
        pictures.convert("RGB").save(still, quality=STILL_QUALITY, method=6)
    return target, still


def shrink(source: Path, target: Path) -> Path:
    """Write a picture of few colours and at most `MOST_BYTES`."""
    pixels: NDArray[np.float32] = matplotlib.image.imread(source)[..., :3]
    whole = Image.fromarray((255 * pixels).round().astype(np.uint8))
    for width in WIDTHS:
        height = round(whole.height * width / whole.width)
        small = whole.resize((width, height), Image.Resampling.LANCZOS)
        small.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
        if target.stat().st_size <= MOST_BYTES:
            return target
    raise ValueError(f"{source}: more than {MOST_BYTES} bytes even at {WIDTHS[-1]} pixels")


if __name__ == "__main__":
    main()
