"""The site: tutorials and examples run as printed, its tables name what there is, it builds."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from pages import ROOT, missing_lines, run, script_of

DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
ARCHITECTURE = (DOCS / "architecture.md").read_text()
CONSTRAINTS = (DOCS / "constraints.md").read_text()
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *DOCS.glob("*.md"),
    *DOCS.glob("how_to/*.md"),
]
# What each example prints, where that is the same on every machine
PRINTED = {
    "compare_payloads": r"0 kg  2\.29\n.*16 kg  none: .*friction",
    "first_climb": r"61 checks.*outputs/first_climb/report\.html",
    "modules": r"verified in its model \(massless modules\).*box from",
    "own_problem": r"(micp|minlp-scip) +optimal +0\.7933",
    "own_terrain": r"optimal.*61 checks",
    "walk_and_simulate": r"verified.*no fall.*\nstands",
}


def clone(folder: Path) -> Path:
    """What a reader in a clone of the repository has."""
    for name in ("specs", "examples"):
        (folder / name).symlink_to(ROOT / name)
    return folder


SLOW = (
    "your_problem",
    "plan_to_robot",
    "dataset_to_strategy",
    "compare_payloads",
    "own_terrain",
    "walk_and_simulate",
    "your_terrain",
    "your_robot",
    "robot_to_motions",
)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if page.stem in SLOW else [])
        for page in TUTORIALS
    ],
)
def test_tutorial_runs_and_prints_what_it_shows(page: Path, tmp_path: Path) -> None:
    text = page.read_text()
    (clone(tmp_path) / "page.py").write_text(script_of(text))
    done = run("python page.py", tmp_path)
    assert done.returncode == 0, done.stderr
    assert not missing_lines(text, done.stdout), done.stdout


@pytest.mark.slow
def test_commands_that_drive_a_robot(tmp_path: Path) -> None:
    for library in ("rosbags", "mcap"):
        pytest.importorskip(library)
    (block,) = re.findall(r"```sh\n(.*?)```", (DOCS / "how_to/drive_a_robot.md").read_text(), re.S)
    done = run(" && ".join(block.strip().splitlines()), clone(tmp_path))
    assert done.returncode == 0, done.stderr
    written = tmp_path / "outputs/drive"
    assert {"motion.mcap", "motion.npz", "ros2_control", "regulator"} <= {
        p.name for p in written.iterdir()
    }


@pytest.mark.slow
def test_commands_that_write_and_measure_a_motion(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    page = (DOCS / "how_to/motions_for_learning.md").read_text()
    block = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)[0]
    done = run(" && ".join(block.strip().splitlines()), clone(tmp_path))
    assert done.returncode == 0, done.stderr
    assert {"tracked_motion.npz", "tracked_motion.terrain.obj"} <= {
        p.name for p in (tmp_path / "outputs/tracked").iterdir()
    }


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in EXAMPLES
    ],
)
def test_example_runs(example: Path, tmp_path: Path) -> None:
    done = run(f"python examples/{example.name}", clone(tmp_path))
    assert done.returncode == 0, done.stderr
    assert re.search(PRINTED[example.stem], done.stdout, re.DOTALL), done.stdout


def declared() -> list[tuple[str, list[str], list[str]]]:
    """Problem, declarations and checkers of every row of the table of constraints."""
    table = CONSTRAINTS.split("| problem | declaration |")[1].split("\n\n")[0]
    rows = [line.split("|")[1:-1] for line in table.splitlines()[2:]]
    return [(row[0].strip(), named(row[1]), named(row[3])) for row in rows]


def named(text: str) -> list[str]:
    """Files and folders of the repository that a text names."""
    return re.findall(r"`((?:climbplan|specs|tests|docs)/[\w/.]*)`", text)


def test_each_problem_has_one_declaration_and_one_checker() -> None:
    assert len(declared()) == 12
    for problem, declarations, checkers in declared():
        assert len(declarations) == 1, problem
        assert len(checkers) == 1, problem


# Rooms of one file
ALONE = {
    "climbplan/arrays.py",
    "climbplan/compiling.py",
    "climbplan/errors.py",
    "climbplan/precompiled.py",
    "climbplan/progress.py",
    "climbplan/reading.py",
    "climbplan/wheel_hook.py",
}


def test_places_beside_a_declaration_are_named_once_with_a_reason() -> None:
    places = re.findall(r"^\| `(climbplan/\S+\.py)` \| (.+) \|$", CONSTRAINTS, re.MULTILINE)
    names = [name for name, _ in places if name not in ALONE]
    assert len(names) == len(set(names))
    assert not set(names) & {name for _, declared, _ in declared() for name in declared}
    assert all(len(reason.split()) > 2 for _, reason in places)


# Rows of programs are written by calls of these; whoever writes some is in the table
WRITES = re.compile(
    r"^import (daqp|clarabel|osqp|highspy|casadi)|^    import osqp|linprog\(|IpoptProgram\("
    r"|Linear(Program|Rows)\(|\b(Program|Trajectory)\(f?\"",
    re.MULTILINE,
)
READS_ONLY = {
    "climbplan/walking/micp/branch_and_bound.py": "solves what `micp/relaxation.py` states",
    "climbplan/walking/planner/planner.py": "names CasADi's version",
}


def test_every_place_that_writes_rows_is_in_the_table() -> None:
    listed = set(named(CONSTRAINTS))
    for family in ("climb", "walking", "limms", "bookshelf"):
        for path in sorted((ROOT / "climbplan" / family).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            if WRITES.search(path.read_text()) and name not in READS_ONLY:
                assert name in listed, f"{name} writes rows: list it in docs/constraints.md"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_pages_name_exist(page: Path) -> None:
    text = page.read_text()
    for name in [*named(text), *re.findall(r"`(benchmarks/[\w/.]*)`", text)]:
        if not name.startswith("docs/_build/"):  # which a build makes
            assert (ROOT / name).exists(), name


def test_layers_of_the_table_are_those_there_are() -> None:
    assert len(ARCHITECTURE.split()) <= 1200
    table = ARCHITECTURE.split("| layer |")[1].split("\n\n")[0]
    listed = {name.rstrip("/").split("/")[-1] for name in named(table)} - {
        Path(name).name for name in ALONE
    }
    there = {p.parent.name for p in (ROOT / "climbplan").glob("*/__init__.py")}
    assert listed == there


def test_pages_are_short_and_nothing_is_left_open() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 150
    for page in [*PAGES, *TUTORIALS]:
        assert not re.search(r"@[A-Z]+@|TODO|placeholder", page.read_text()), page


def test_gallery_pictures_are_small_and_one_for_each_scene() -> None:
    pictures = {path.stem: path.stat().st_size for path in (DOCS / "gallery").glob("*.png")}
    kinds = r"^kind: *(climb|transition|mpc|limms|bookshelf)\b"
    scenes = {
        path.stem
        for path in (ROOT / "specs").glob("*.yaml")
        if re.search(kinds, path.read_text(), re.MULTILINE)
    }
    assert set(pictures) == scenes
    assert max(pictures.values()) <= 60_000
    assert sum(pictures.values()) < 42_000 * len(pictures)


def test_pictures_of_pages_are_small_and_as_many_as_are_shown() -> None:
    sys.path.insert(0, str(DOCS / "_ext"))
    try:
        from page_pictures import LOOKS, PAGES, picture, pictures_page
    finally:
        sys.path.pop(0)
    kept = {path.name: path.stat().st_size for path in (DOCS / "pages").iterdir()}
    assert set(kept) == {picture(page.name, look) for page in PAGES for look in LOOKS}
    assert sum(kept.values()) < 3_000_000
    assert "generated/pages" in (DOCS / "index.md").read_text()
    shown = re.findall(r"\(\.\./pages/(.*?)\)", pictures_page(DOCS / "pages"))
    assert sorted(shown) == sorted(kept)
