"""What notebooks show: plans, verifications and solutions as HTML, methods by Tab."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import climbplan
from climbplan.errors import UsageError
from climbplan.reports.notebook import MAX_FRAMES, thin_scene

SPEC = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-0.8, 1.0]},
    },
    "task": {"rounds": 2, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.2]}},
}


@pytest.fixture(scope="module")
def plan() -> climbplan.Plan:
    return climbplan.plan(SPEC)


def test_a_plan_shows_level_figures_and_an_offline_replay(plan: climbplan.Plan) -> None:
    page = plan._repr_html_()
    assert ">fine</b>" in page
    assert "color:#fff" in page  # on its own ground, on dark pages too
    assert "24 instants" in page
    assert "<iframe" in page
    assert "srcdoc" in page
    assert "http:" not in page
    assert "https:" not in page
    assert len(page) < 1_000_000


def test_a_replay_keeps_the_ends_of_a_long_scene(plan: climbplan.Plan) -> None:
    scene = plan._kind.read_scene(plan._path)
    thinned = thin_scene(scene)
    assert len(scene.time) > MAX_FRAMES
    assert len(thinned.time) == len(thinned.caption) == MAX_FRAMES
    assert thinned.time[0] == scene.time[0]
    assert thinned.time[-1] == scene.time[-1]
    assert thinned.rods is not None
    assert scene.rods is not None
    np.testing.assert_array_equal(thinned.rods.ends[-1], scene.rods.ends[-1])
    assert thin_scene(thinned) is thinned


def test_a_verification_lists_the_worst_first(plan: climbplan.Plan) -> None:
    checked = plan.verify()
    page = checked._repr_html_()
    places = {check.name: page.index(f"<td>{check.name}</td>") for check in checked.checks}
    assert min(places, key=places.__getitem__) == checked.tightest.name
    assert '<div style="overflow-x:auto"><table>' in page  # narrow windows scroll the table alone
    assert page.index("49 further checks") > page.index("<details>") > places["force.friction"]
    assert repr(checked).startswith("<Verification: verified; fine; 61 checks")
    failed = plan.verify(SPEC, {"force.safety_friction": 2.0})
    assert failed._repr_html_().index("<td>failed</td>") < failed._repr_html_().index("<td>passed")


def test_tab_lists_methods_and_arrays(plan: climbplan.Plan) -> None:
    names = dir(plan)
    assert {"show", "view", "film", "export", "verify", "instants", "rounds"} <= set(names)
    assert not [name for name in names if name.startswith("_")]
    assert len(names) == len(set(names))


def test_export_writes_what_the_command_does(plan: climbplan.Plan, tmp_path: Path) -> None:
    path = plan.export(tmp_path / "motion.npz", "npz", rate=100.0)
    with np.load(path) as arrays:
        assert "time" in arrays
    with pytest.raises(UsageError, match="already exists"):
        plan.export(path, "npz")
    with pytest.raises(UsageError, match="expected one of csv, npz"):
        plan.export(tmp_path / "other", "nonsense")


def test_a_solution_names_the_nearest_variable() -> None:
    program = climbplan.Program("level")
    x = program.continuous("height", (2,), lower=0.0, upper=1.0)
    program.minimise("cost", np.sum(x**2))
    solution = climbplan.solve(program)
    assert "<td>height</td>" in solution._repr_html_()
    with pytest.raises(KeyError, match="did you mean 'height'"):
        solution["hieght"]


def test_a_motion_for_policies_is_exported(plan: climbplan.Plan, tmp_path: Path) -> None:
    path = plan.export(tmp_path / "motion.npz", "motion", rate=20.0)
    with np.load(path) as motion:
        assert motion["fps"] == 20
        assert motion["contact"].shape[1] == 6
        assert motion["verified"]
    with pytest.raises(UsageError, match=r"\.npz"):
        plan.export(tmp_path / "motion.csv", "motion")
    with pytest.raises(UsageError, match="motion"):
        plan.export(tmp_path / "x", "nothing")
