"""Every command and code block of the README, and of the guides of the package, runs as printed.

The README has two commands, each with a test of its own.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from pages import ROOT, run, shell_lines

from benchmarks.app import app

README = (ROOT / "README.md").read_text()
SCENES = ROOT / "specs" / "README.md"
COMMANDS = ROOT / "docs" / "command_line.md"
PAGES = [
    *(ROOT / "README.md", COMMANDS, SCENES, ROOT / "benchmarks" / "README.md"),
    *sorted((ROOT / "climbplan").rglob("README.md")),
]
BENCHMARK = "python -m benchmarks "


SHELL_LINES = shell_lines(README)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("readme")
    (path / "specs").symlink_to(ROOT / "specs")
    return path


def test_two_command_lines_each_on_one_line() -> None:
    installing = [line for line in SHELL_LINES if "pip install" in line]
    assert len(installing) == 2
    assert installing[0].endswith("climbplan plan-climb specs/climb_tube.yaml")
    assert installing[1].endswith("-m pytest -n 2 --dist worksteal")
    # What CI runs is the second one.
    assert r"grep -m1 'pip install.*\[test\]' README.md" in (ROOT / ".ci" / "run").read_text()


def test_main_command_plans_and_verifies(folder: Path) -> None:
    line = next(line for line in SHELL_LINES if "plan-climb specs/climb_tube.yaml" in line)
    command = line.split("&&")[-1].strip().removeprefix(".venv/bin/")
    done = run(command, folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "outputs/climb_tube/plan.h5\n"
    assert "passed" in done.stderr
    made = {p.name for p in (folder / "outputs" / "climb_tube").iterdir()}
    assert made == {"plan.h5", "report.json", "report.html", "figures"}


# Pages whose commands take a quarter of a minute and more
LONG = ("docs", "datasets", "limms", "walking", "robots", "grips", "simulation")


@pytest.mark.timeout(3000)  # some pages propose several robots, each of minutes
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page,
            id=page.parent.name,
            marks=[pytest.mark.slow] if page.parent.name in LONG else [],
        )
        for page in PAGES
    ],
)
def test_other_commands_run_in_order(page: Path, tmp_path: Path) -> None:
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    lines = [line for line in shell_lines(page.read_text()) if line.startswith("climbplan ")]
    for line in lines:
        done = run(line, tmp_path)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


def test_benchmarks_of_pages_have_the_options_that_are_shown() -> None:
    """They take minutes: run by hand, with the table they print."""
    commands = typer.main.get_group(app).commands
    lines = [line for page in PAGES for line in shell_lines(page.read_text())]
    shown = [line.split("#")[0].split()[3:] for line in lines if line.startswith(BENCHMARK)]
    assert len(shown) > 10
    for name, *options in (words for words in shown if words != ["--list"]):
        commands[name].make_context(name, options)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        if page == COMMANDS and target.startswith("generated/"):
            continue  # made when the site is built, which checks links itself
        assert (page.parent / target).exists(), target


def test_commands_of_the_table_exist(folder: Path) -> None:
    named = set(re.findall(r"\| `climbplan ([a-z-]+)", COMMANDS.read_text()))
    listing = run("COLUMNS=200 climbplan --help", folder).stdout
    assert named
    for name in named:
        assert re.search(rf"^\W*{name}\b", listing, re.MULTILINE), name


def test_python_block_runs() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", block], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"verified \d+ checks, worst margin", done.stdout)


def test_specs_of_the_table_exist() -> None:
    named = re.findall(r"^\| `(\w+\.yaml)`", SCENES.read_text(), re.MULTILINE)
    assert sorted(named) == sorted(p.name for p in (ROOT / "specs").glob("*.yaml"))


def test_no_placeholder_is_left() -> None:
    for page in PAGES:
        assert not re.search(r"@[A-Z]+@|TODO|placeholder", page.read_text()), page


def test_yaml_block_is_a_valid_spec(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", README, re.DOTALL)
    (tmp_path / "spec.yaml").write_text(block)
    done = run("climbplan validate spec.yaml", tmp_path)
    assert done.returncode == 0, done.stderr
