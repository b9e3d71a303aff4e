"""Make the gallery's pictures: plan every shipped scene and keep one figure of each, small.

python docs/make_gallery.py             all of them, some eight minutes
python docs/make_gallery.py mpc_turn    some
python docs/make_gallery.py --from outputs mpc_turn    of plans that are there already
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import matplotlib.image
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
from gallery_page import Scene, scenes

import climbplan

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
MOST_BYTES = 60_000
WIDTHS = (760, 680, 600, 520, 440, 360)  # [pixels], the widest that fits
COLOURS = 200  # fewer make two limbs one colour


def main() -> None:
    """Read the command line, make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="scenes; all if left out")
    parser.add_argument("--from", dest="plans", type=Path, help="folder of plans by scene")
    given = parser.parse_args()
    for scene in scenes(ROOT / "specs"):
        if not given.names or scene.name in given.names:
            path = make(scene, given.plans)
            print(f"{path.relative_to(ROOT)} {path.stat().st_size / 1000:.0f} kB", flush=True)


def make(scene: Scene, plans: Path | None) -> Path:
    """The picture of one scene."""
    with tempfile.TemporaryDirectory() as folder:
        if plans is None:
            made = climbplan.plan(ROOT / "specs" / f"{scene.name}.yaml")
        else:
            made = climbplan.load_plan(plans / scene.name)
        made.write_report(folder)
        figures = Path(folder) / "figures"
        drawn = next(figures / f for f in FIGURES[scene.kind] if (figures / f).exists())
        return shrink(drawn, PICTURES / f"{scene.name}.png")


def shrink(source: Path, target: Path) -> Path:
    """A picture of few colours and at most `MOST_BYTES`."""
    from PIL import Image  # comes with Matplotlib

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
