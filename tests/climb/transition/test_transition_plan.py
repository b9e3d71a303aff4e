"""Transition plans from spec to verified file."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scenes import PlannedScenes

from climbplan.climb.check.verification import verify
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition

SPECS = Path(__file__).parents[3] / "specs"
FLAT = SPECS / "transition_flat.yaml"


@pytest.fixture(scope="session")
def plan(planned_scenes: PlannedScenes) -> ClimbPlan:
    return read_climb(planned_scenes["transition"])


@pytest.fixture
def file(plan: ClimbPlan, tmp_path: Path) -> Path:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    return path


def test_tripods_are_verified(plan: ClimbPlan, file: Path) -> None:
    verification = verify(file)
    assert verification.passed, verification.table()
    assert plan.contact_sequence.startswith("3-3: ")
    assert plan.instants.count == 4
    assert plan.forces.safety_torque.min() >= 1.8
    assert plan.instants.lifted.sum(axis=1).tolist() == [3, 0, 3, 0]


def test_the_file_keeps_everything(plan: ClimbPlan, file: Path) -> None:
    with h5py.File(file) as store:
        assert store.attrs["format"] == "climbplan/transition"
        assert store.attrs["contact_sequence"] == plan.contact_sequence
        assert len(store["sequences/name"]) == 2
    back = read_climb(file)
    assert back.kind == "transition"
    assert back.sequences is not None
    assert plan.sequences is not None
    assert back.sequences.name == plan.sequences.name
    assert back.sequences.outcome.count("chosen") == 1


def _lift_one_more(store: h5py.File) -> None:
    store["instants/lifted"][0, :4] = True


def _drop(store: h5py.File) -> None:
    store["rounds/toes"][1, 1] += [0.0, 0.01, 0.0]


def _slippery(store: h5py.File) -> None:
    store["instants/force"][0] *= 1.1


@pytest.mark.parametrize(
    ("change", "check"),
    [
        (_lift_one_more, "gait.sequence"),
        (_drop, "gait.sequence"),
        (_slippery, "force.equilibrium"),
    ],
)
def test_tampering_is_found(file: Path, change: object, check: str) -> None:
    assert callable(change)
    with h5py.File(file, "r+") as store:
        change(store)
    assert check in {c.name for c in verify(file).failed}


def test_pairs_in_three_rounds(tmp_path: Path) -> None:
    loaded = load_transition(
        FLAT,
        ["task.rounds=3", "task.sequence=2-2-2", "search.heights=3", "search.max_sequences=20"],
    )
    pairs = plan_transition(loaded)
    write_climb(pairs, tmp_path / "plan.h5")
    assert verify(tmp_path / "plan.h5").passed
    assert pairs.contact_sequence.startswith("2-2-2: ")
    # The body waits while limbs are in the air.
    flying = np.logical_not(pairs.trajectory.contact.all(axis=1))
    still = np.asarray(np.linalg.norm(np.diff(pairs.trajectory.com, axis=0), axis=1) < 1e-12)
    assert still[flying[1:] & flying[:-1]].all()


@pytest.mark.parametrize(
    ("name", "asked", "sequence", "stands"),
    [
        ("transition_bricks", None, "3-3-3: RM LR LF | RM LR LF | RF RR LM", True),
        (
            "transition_bricks",
            "LF LR RM | RF RR LM | LF LR RM",  # as published
            "3-3-3: RM LR LF | RF RR LM | RM LR LF",
            False,
        ),
        ("transition_bricks_4", None, "3-1-2-2: RM LR LF | LM | RF RR | LR LF", False),
    ],
)
def test_bricks(name: str, asked: str | None, sequence: str, stands: bool, tmp_path: Path) -> None:
    overrides = [f"task.sequence={asked}"] if asked else []
    found = plan_transition(load_transition(SPECS / f"{name}.yaml", overrides))
    write_climb(found, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()
    assert found.contact_sequence == sequence
    assert (verification.fragile == ()) == stands
    on_bricks = found.rounds.region[1, [3, 5]]
    names = {found.terrain.surfaces[r].name for r in on_bricks}
    assert names == {"front brick", "rear brick"}
    assert found.rounds.toes[1, [3, 5], 2] == pytest.approx(0.09)


@pytest.mark.parametrize("rounds", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_complementarity_finds_its_own_sequence(rounds: int, tmp_path: Path) -> None:
    overrides = [f"task.rounds={rounds}", "solver.method=mpcc", "solver.starts=2"]
    found = plan_transition(load_transition(FLAT, overrides))
    write_climb(found, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()
    assert found.rounds.count == rounds
    assert found.instants.lifted[::2].any(axis=1).all()
