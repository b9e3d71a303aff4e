"""Method `auto`: what it tries, what it tells, and that its remedies work."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.automatic import NoTrialSucceeded
from climbplan.climb.planner.planner import plan_by_method, plan_climb
from climbplan.climb.planner.trials import generate_further_trials, select_first_trial
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.schema.loading import LoadedClimb, load_climb
from climbplan.errors import Infeasible, ReachFailure, Unresolved

# Two stairs of 50 mm as boxes, which are obstacles to limbs and places for toes at once
STAIRS = """
kind: climb
robot: silvia
terrain:
  friction: 0.8
  ground: {height: 0, across: [-0.8, 0.8], along: [-1, 0.5]}
  boxes:
    - {name: first step, lower: [-0.8, 0.5, 0.0], upper: [0.8, 0.85, 0.05]}
    - {name: second step, lower: [-0.8, 0.85, 0.0], upper: [0.8, 2.0, 0.10]}
task:
  rounds: 5
  start: {com: [0, 0, 0.24]}
  goal: {com: [0, 0.60, 0.28], rpy_deg: [4, 0, 0]}
  stance:
    RF: [0.256, 0.445, -0.24]
    RM: [0.514, 0.000, -0.24]
    RR: [0.256, -0.445, -0.24]
    LR: [-0.256, -0.445, -0.24]
    LM: [-0.514, 0.000, -0.24]
    LF: [-0.256, 0.445, -0.24]
"""
# With steps that first-order rotations do not admit
TOO_FEW = ("solver.method=micp", "task.rounds=3", "posture.steps.com_max=0.22")
SHAFT: dict[str, Any] = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {"friction": 1.0, "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-0.8, 1.4]}},
    "task": {"rounds": 2, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.2]}},
    "solver": {"time_limit": 20.0},
}


def loaded(tmp_path: Path, text: str | dict[str, Any], *assignments: str) -> LoadedClimb:
    path = tmp_path / "spec.yaml"
    path.write_text(text if isinstance(text, str) else yaml.safe_dump(text))
    return load_climb(path, list(assignments))


def test_the_global_method_comes_first(tmp_path: Path) -> None:
    plan = plan_climb(loaded(tmp_path, SHAFT))
    assert plan.solvers["method"] == "micp"
    assert plan.spec_text == (tmp_path / "spec.yaml").read_text()
    assert not any("found by" in note for note in plan.notes)


@pytest.mark.slow
def test_stairs_as_boxes_are_planned(tmp_path: Path) -> None:
    plan = plan_climb(loaded(tmp_path, STAIRS))
    assert plan.solvers["method"] == "nlp"
    assert plan.notes[0].startswith("found by nlp; by micp not: ")
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    assert verify(path).passed


def test_no_method_calls_its_own_restriction_a_proof(tmp_path: Path) -> None:
    with pytest.raises(Unresolved) as caught:
        plan_climb(loaded(tmp_path, STAIRS, *TOO_FEW))
    assert caught.value.exit_code == 4
    assert "not proved: method micp has rotations and knees linearised" in str(caught.value)


def test_a_named_remedy_works(tmp_path: Path) -> None:
    """Too few rounds at the default steps: not proved, and the rounds that are enough are found."""
    spec = loaded(tmp_path, SHAFT, "task.goal.com=[0, 0, 0.4]")
    with pytest.raises(NoTrialSucceeded) as caught:
        plan_climb(spec)
    text = str(caught.value)
    assert caught.value.exit_code == 4
    assert "takes 3 rounds at least" in text
    assert "with each of these changes a plan was found and verified:" in text
    remedies = {remedy.key: remedy for remedy in caught.value.remedies}
    rounds = remedies["task.rounds"]
    assert f"--set task.rounds={rounds.value}" in text
    changed = f"{rounds.key}={rounds.yaml}"
    assert plan_climb(spec.with_overrides([changed])).rounds.count == rounds.value


@pytest.mark.slow
def test_stated_steps_make_it_a_proof(tmp_path: Path) -> None:
    spec = loaded(tmp_path, SHAFT, "task.goal.com=[0, 0, 0.4]", "posture.steps.com_max=0.15")
    with pytest.raises(Infeasible) as caught:
        plan_climb(spec)
    assert caught.value.exit_code == 3
    # Its own changes take the proof away; those that are named were planned with
    assert not any(conflict.remedies for conflict in caught.value.conflicts)
    remedies = caught.value.remedies
    assert "task.rounds" in [remedy.key for remedy in remedies]
    for remedy in remedies:
        assert remedy.option in str(caught.value)
        plan_climb(spec.with_overrides([f"{remedy.key}={remedy.yaml}"]))


def test_the_limit_is_kept(tmp_path: Path) -> None:
    spec = loaded(tmp_path, STAIRS, "solver.time_limit=4", "task.goal.com=[0, 0.9, 0.28]")
    begin = time.monotonic()
    with pytest.raises(Unresolved):
        plan_climb(spec)
    assert time.monotonic() - begin < 10.0  # twice, and a second for a loaded machine


def test_only_what_the_spec_leaves_open_is_chosen(tmp_path: Path) -> None:
    open_spec = loaded(tmp_path, SHAFT)
    error = ReachFailure("RF", "coxa 5 deg past its bound")
    scene = build_scene(open_spec.spec, open_spec.robot)
    keys = {c.key for t in generate_further_trials(scene, error) for c in t.choices}
    assert keys == {"trajectory.swing_clearance", "task.gait", "task.goal.rotation_tolerance_deg"}
    stated = open_spec.with_overrides(
        [
            "trajectory.swing_clearance=0.05",
            "task.gait=[RF, RM, RR, LR, LM, LF]",
            "task.goal.rpy_deg=[0, 0, 0]",
        ]
    )
    scene = build_scene(stated.spec, stated.robot)
    trials = list(generate_further_trials(scene, error))
    assert all(not trial.choices for trial in trials)
    assert [trial.method for trial in trials] == ["nlp", "coupled"]


def test_a_choice_is_part_of_the_stored_spec(tmp_path: Path) -> None:
    """A front limb at the edge of its coxa's range: lifted by 50 mm it leaves it, by less not."""
    from climbplan.climb.planner.automatic import apply_choices

    spec = loaded(tmp_path, SHAFT)
    scene = build_scene(spec.spec, spec.robot)
    trials = generate_further_trials(scene, ReachFailure("RF", "coxa 5 deg past its bound"))
    lower = next(
        t for t in trials if t.choices and t.choices[0].key == "trajectory.swing_clearance"
    )
    plan = plan_climb(apply_choices(spec, lower))
    assert yaml.safe_load(plan.spec_text)["trajectory"] == {"swing_clearance": 0.03}
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    assert verify(path).passed


def test_curved_terrain_goes_to_the_exact_method(tmp_path: Path) -> None:
    tube = load_climb(Path("specs/climb_tube.yaml"), ["solver.method=auto"])
    assert select_first_trial(build_scene(tube.spec, tube.robot)).method == "nlp"


def test_a_plan_that_fails_its_verification_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 5 and a plan that is marked, rather than none: as with a method that is named."""

    def dearer(*given: Any) -> ClimbPlan:
        plan = plan_by_method(*given)
        return replace(plan, objective=2 * plan.objective)

    monkeypatch.setattr("climbplan.climb.planner.planner.plan_by_method", dearer)
    kept = plan_climb(loaded(tmp_path, SHAFT))
    path = tmp_path / "plan.h5"
    write_climb(kept, path)
    assert [check.name for check in verify(path).failed] == ["file.objective"]


def test_a_closest_sequence_is_not_always_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = "climbplan.solvers.elastic.minimise_violations"
    monkeypatch.setattr(module, lambda *_: None)
    with pytest.raises(Unresolved, match="no posture sequence found under the given bounds"):
        plan_climb(loaded(tmp_path, STAIRS, *TOO_FEW))
