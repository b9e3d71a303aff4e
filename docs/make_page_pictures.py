"""Take the pictures of reports' pages: wide and narrow, light and dark, and as they are printed.

python docs/make_page_pictures.py                all of them, some ten minutes
python docs/make_page_pictures.py climb walk     some
python docs/make_page_pictures.py --work DIR     with what was planned in DIR before

Needs Chromium and pdftoppm (of poppler-utils).
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import trimesh
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "reports"))

from headless_chromium import Browser, chromium_path
from page_pictures import LOOKS, PAGES, ReportPage, picture

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pages"
MOST_BYTES = 3_000_000  # of all together
_WIDE, _PHONE = 1400, 400  # [pixels]
_WIDTHS = {"wide": 540, "phone": 220}  # [pixels] kept
_PHONE_SCREENS = 6  # of a phone's page, as high as wide: the rest goes on as long
_SETTLED = 1.5  # [s] until charts are drawn
_SHEET = (4, 200)  # printed pages beside one another, and their width [pixels]


def main() -> None:
    """Read the command line, make the pages, take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="pages; all if left out")
    parser.add_argument("--work", type=Path, help="folder of plans, kept")
    given = parser.parse_args()
    program = chromium_path()
    if program is None or shutil.which("pdftoppm") is None:
        sys.exit("needs chromium and pdftoppm (apt-get install chromium poppler-utils)")
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        work = (given.work or Path(scratch)).resolve()
        make_scene(work)
        for page in PAGES:
            if given.names and page.name not in given.names:
                continue
            if not (work / page.path).exists():
                make_page(page, work)
            take(page, work, program)
    total = sum(path.stat().st_size for path in PICTURES.glob("*.webp"))
    print(f"{total / 1e6:.2f} MB")
    if total > MOST_BYTES:
        sys.exit(f"more than {MOST_BYTES / 1e6:g} MB")


def make_scene(work: Path) -> None:
    """What commands read beside the specs."""
    work.mkdir(parents=True, exist_ok=True)
    if not (work / "specs").exists():
        (work / "specs").symlink_to(ROOT / "specs")
    ground = trimesh.creation.box((1.2, 1.0, 0.1))
    wall = trimesh.creation.box((0.1, 1.0, 1.0)).apply_translation((0.6, 0, 0.5))
    trimesh.util.concatenate([ground, wall]).export(work / "corner.stl")


def make_page(page: ReportPage, work: Path) -> None:
    """Run a page's commands; of several the first may have been run before."""
    for command in page.commands:
        words = [sys.executable, "-m", "climbplan", *shlex.split(command), "--quiet"]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True)
        if done.returncode and "already exists" not in done.stderr:
            sys.exit(f"climbplan {command}: {done.stderr}")


def take(page: ReportPage, work: Path, program: str) -> None:
    """All pictures of a page."""
    with Browser(program) as browser:
        for look in LOOKS:
            shot = work / f"shot_{look}.png"
            if look == "print":
                browser.emulate(width=_WIDE, height=900)
            else:
                kind, colours = look.split("_")
                phone = kind == "phone"
                width = _PHONE if phone else _WIDE
                browser.emulate(width=width, height=900, dark=colours == "dark", phone=phone)
            browser.open(work / page.path)
            time.sleep(_SETTLED)
            if look == "print":
                browser.print_pdf(work / "shot.pdf")
                drawn = printed_sheet(work / "shot.pdf")
            else:
                browser.picture(shot, whole=True)
                drawn = shrunk(shot, kind)
            target = PICTURES / picture(page.name, look)
            drawn.save(target, quality=45, method=6)
            print(f"{target.relative_to(ROOT)} {target.stat().st_size / 1000:.0f} kB", flush=True)


def shrunk(shot: Path, kind: str) -> Image.Image:
    """A screenshot as wide as it is kept; of a phone's the first screens."""
    whole = Image.open(shot).convert("RGB")
    if kind == "phone":
        whole = whole.crop((0, 0, whole.width, min(whole.height, _PHONE_SCREENS * whole.width)))
    width = _WIDTHS[kind]
    return whole.resize(
        (width, round(whole.height * width / whole.width)), Image.Resampling.LANCZOS
    )


def printed_sheet(pdf: Path) -> Image.Image:
    """Printed pages side by side."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["pdftoppm", "-r", "60", "-png", pdf, f"{folder}/page"], check=True)
        pages = [Image.open(path).convert("RGB") for path in sorted(Path(folder).glob("*.png"))]
    across, width = _SHEET
    height = round(width * pages[0].height / pages[0].width)
    rows = -(-len(pages) // across)
    sheet = Image.new("RGB", (across * (width + 4), rows * (height + 4)), "#b8bfc8")
    for k, page in enumerate(pages):
        place = ((k % across) * (width + 4) + 2, (k // across) * (height + 4) + 2)
        sheet.paste(page.resize((width, height), Image.Resampling.LANCZOS), place)
    return sheet


if __name__ == "__main__":
    main()
