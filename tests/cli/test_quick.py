"""`--quick` and `--no-report`: what they leave out, and that `--set` is stronger."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from command_line import RunCommand

from climbplan.bookshelf.schema.loading import load_shelf
from climbplan.cli.quick import quick_overrides
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.limms.schema.loading import load_limms
from climbplan.walking.schema.loading import load_mpc

SPECS = Path(__file__).parents[2] / "specs"
SHORT = ("task.rounds=1", "task.goal.com=[0,0,0.04]", "task.goal.toes={}")


def test_what_it_sets_by_kind() -> None:
    climb = load_climb(SPECS / "climb_region.yaml", quick_overrides("climb", True)).spec
    assert (climb.solver.gap, climb.solver.starts, climb.study) == (0.01, 2, None)
    transition = load_transition(
        SPECS / "transition_flat.yaml", quick_overrides("transition", True)
    ).spec
    assert transition.solver.starts == 2
    walk = load_mpc(SPECS / "mpc_recovery.yaml", quick_overrides("mpc", True)).spec
    assert (walk.solver.max_qp_solves, walk.library.size) == (150, 6)
    shelf = load_shelf(SPECS / "bookshelf_five.yaml", quick_overrides("bookshelf", True)).spec
    assert shelf.solver.gap == 0.05
    modules = SPECS / "limms_throw.yaml"
    assert load_limms(modules, quick_overrides("limms", True)).spec == load_limms(modules).spec
    assert quick_overrides("climb", False) == []


def test_what_goes_further_already_stays(tmp_path: Path) -> None:
    text = yaml.safe_load((SPECS / "climb_steps.yaml").read_text())
    text["solver"] = {"gap": 0.2, "starts": 1}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(text))
    own = load_climb(tmp_path / "own.yaml", quick_overrides("climb", True)).spec.solver
    assert (own.gap, own.starts) == (0.2, 1)


def test_set_is_stronger(run_command: RunCommand, workplace: Path) -> None:
    settings = [part for one in (*SHORT, "solver.gap=0.002") for part in ("--set", one)]
    done = run_command("plan-climb", "small.yaml", "--quick", *settings)
    assert done.code == 0, done.err
    folder = workplace / "outputs" / "small"
    assert {p.name for p in folder.iterdir()} == {"plan.h5", "report.json"}
    report = json.loads((folder / "report.json").read_text())
    assert report["verified"] is True
    assert report["figures"] == []
    solver = yaml.safe_load(report["spec"])["solver"]
    assert (solver["gap"], solver["starts"]) == (0.002, 2)
    assert run_command("report", "outputs/small").code == 0  # the page can still be made
    assert (folder / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "spec"),
    [
        ("plan-mpc", "mpc_turn"),
        ("solve-bookshelf", "bookshelf_scene"),
        ("plan-climb", "climb_steps"),
        ("plan-limms", "limms_throw"),
        ("plan-transition", "transition_flat"),
    ],
)
def test_quick_plans_hold_and_load_nothing_that_draws(
    tmp_path: Path, command: str, spec: str
) -> None:
    code = (
        "import sys\n"
        "from climbplan.cli.app import run\n"
        f"code = run(['{command}', '{SPECS / spec}.yaml', '--quick', '-q', '-o', 'plan'])\n"
        "drawing = {'matplotlib', 'plotly', 'PIL'} & set(sys.modules)\n"
        "sys.exit(code or (f'loaded {drawing}' if drawing else 0))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "plan" / "report.json").read_text())
    assert report["verified"] is True
