"""What is released: a wheel that works alone, on every Python and with the oldest libraries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PYTHONS = ("3.11", "3.12", "3.13")
MAIN = "plan-climb specs/climb_tube.yaml"  # the README's


def run(*command: str | Path, **more: str | Path) -> str:
    """Standard output; a command that fails is told with what it said."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=more.get("cwd"),
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The wheel and the source distribution."""
    pytest.importorskip("hatchling", reason="hatchling is missing: pip install '.[test]'")
    place = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "hatchling", "build", "-d", place, cwd=ROOT)
    (wheel,), (source,) = place.glob("*.whl"), place.glob("*.tar.gz")
    return wheel, source


def test_the_wheel_holds_all_that_runs_and_nothing_else(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[0]) as wheel:
        names = set(wheel.namelist())
        described = next(name for name in names if name.endswith(".dist-info/METADATA"))
        about = message_from_string(wheel.read(described).decode())
        points = wheel.read(described.replace("METADATA", "entry_points.txt")).decode()
    there = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "climbplan").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    specs = {
        f"climbplan/example_specs/{path.name}"
        for path in (ROOT / "specs").iterdir()
        if path.is_file()
    }
    there.remove("climbplan/wheel_hook.py")  # runs where wheels are built
    own = {name for name in names if ".dist-info/" not in name}
    assert own == there | specs
    assert about["Name"] == PROJECT["name"]
    assert about["Version"] == PROJECT["version"]
    assert about["Requires-Python"] == PROJECT["requires-python"]
    assert any(name.endswith("/licenses/LICENSE") for name in names)
    assert "climbplan = climbplan.cli.app:main" in points


def test_the_source_distribution_builds_and_tests_itself(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[1]) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    for needed in ("pyproject.toml", "README.md", "LICENSE", "tests/test_release.py",
                   "specs/climb_tube.yaml", "docs/conf.py", "climbplan/py.typed",
                   "benchmarks/__main__.py"):  # fmt: skip
        assert needed in names, needed
    assert not {name for name in names if name.startswith(("outputs/", ".git/", "docs/_build"))}


def interpreter(version: str) -> str:
    """A Python of this version."""
    found = shutil.which(f"python{version}")
    if found is not None and run_quietly(found, "-c", "import venv, ensurepip"):
        return found
    for place in (Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"):
        return str(place)
    pytest.skip(f"no Python {version} here")


def run_quietly(*command: str) -> bool:
    return subprocess.run(command, capture_output=True).returncode == 0


def main_job(place: Path, program: Path) -> None:
    """The README's main command in a folder of its own, and what it leaves there."""
    folder = place / "work"
    shutil.copytree(ROOT / "specs", folder / "specs")
    assert "climb_tube" in run(program, *MAIN.split(), cwd=folder)
    made = folder / "outputs" / "climb_tube"
    page = (made / "report.html").read_text(encoding="utf-8")
    assert "</html>" in page
    assert "passed" in page
    run(program, "verify", made, cwd=folder)
    run(program, "new", "climb", folder / "mine", cwd=folder)
    assert list((folder / "mine").glob("*.yaml"))


@pytest.mark.slow
@pytest.mark.parametrize("version", PYTHONS)
def test_the_wheel_alone_does_the_main_job(
    version: str, built: tuple[Path, Path], tmp_path: Path
) -> None:
    run(interpreter(version), "-m", "venv", tmp_path / "bare")
    run(tmp_path / "bare/bin/python", "-m", "pip", "install", "-q", built[0])
    told = run(
        tmp_path / "bare/bin/python", "-c", "import sys; print(*sys.version_info[:2], sep='.')"
    )
    assert told.strip() == version
    main_job(tmp_path, tmp_path / "bare/bin/climbplan")


# One command of each family, so that every library is used
JOBS = (
    "plan-climb specs/climb_steps.yaml --solver clarabel",
    "plan-transition specs/transition_flat.yaml",
    "plan-mpc specs/mpc_forward.yaml",
    "plan-limms specs/limms_throw.yaml",
    "solve-bookshelf specs/bookshelf_five.yaml",
    "solve specs/cart_pole.yaml --problem specs/cart_pole.py:problem",
    "gen-data specs/dataset_cart_pole.yaml --problem specs/cart_pole.py:springs --set count=4",
    "fit-stiffness specs/limb_test.csv",
    "fit-strategy specs/strategy_bookshelf.yaml",
    "export outputs/climb_steps --format npz -o motion.npz",
    "doctor",
)


@pytest.mark.slow
def test_the_oldest_libraries_that_are_allowed_do_every_job(
    built: tuple[Path, Path], tmp_path: Path
) -> None:
    """Each lower bound of pyproject.toml at its very version."""
    venv.create(tmp_path / "tool", with_pip=True)
    tool = tmp_path / "tool/bin"
    if not run_quietly(str(tool / "python"), "-m", "pip", "install", "-q", "uv"):
        pytest.skip("uv cannot be installed here")
    old = tmp_path / "old"
    run(tool / "uv", "venv", "-q", "--python", interpreter("3.11"), old)
    install = (tool / "uv", "pip", "install", "-q", "--python", old / "bin/python")
    run(*install, "--resolution", "lowest-direct", "-r", ROOT / "pyproject.toml")
    run(*install, "--no-deps", built[0])
    program = old / "bin/climbplan"
    main_job(tmp_path, program)
    for job in JOBS:
        run(program, *job.split(), cwd=tmp_path / "work")
