"""The search over stance sets: all sequences, checked by other means."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import state_forces
from climbplan.spec.transition_loading import load_transition
from climbplan.transition.footholds import GOAL, START
from climbplan.transition.scene import build_transition
from climbplan.transition.search import Search, stance_of_move
from climbplan.transition.stances import largest_friction_factor, stance_instants

FLAT = Path(__file__).parents[2] / "specs" / "transition_flat.yaml"


def search(*overrides: str) -> Search:
    return Search(build_transition(load_transition(FLAT, overrides)))


@pytest.fixture(scope="module")
def tripods() -> Search:
    found = search()
    found.sequences()
    return found


def test_fourteen_tripod_sequences(tripods: Search) -> None:
    found = tripods.sequences()
    assert len(found) == 14
    assert {tripods.name(s).partition(":")[0] for s in found} == {"3-3"}
    assert [s.cost for s in found] == sorted(s.cost for s in found)
    assert "3-3: RF RR LM | RM LR LF" in {tripods.name(s) for s in found}


def test_every_limb_moves_once_and_safety_is_as_asked(tripods: Search) -> None:
    asked = tripods.scene.spec.force
    for sequence in tripods.sequences():
        assert (sequence.moved.sum(axis=0) == 1).all()
        assert sequence.safety_torque >= asked.safety_torque
        assert sequence.safety_friction >= asked.safety_friction * 0.99
        assert sequence.poses[0] == 0
        assert sequence.poses[-1] == tripods.lab.poses.count - 1


def test_no_sequence_is_missed(tripods: Search) -> None:
    """Every tripod at every pose by the exact cones of Clarabel: the search misses none."""
    lab, n = tripods.lab, 6
    found = {s.moved.tobytes() for s in tripods.sequences()}
    count = lab.poses.count
    for limbs in itertools.combinations(range(n), 3):
        first = tuple(GOAL if i in limbs else START for i in range(n))
        start, goal = (START,) * n, (GOAL,) * n
        holds = []
        for number, (a, b) in enumerate(((start, first), (first, goal))):
            at = np.flatnonzero(tripods._reachable(number, a, b))
            row = np.tile(stance_of_move(a, b), (len(at), 1))
            statement = state_forces(tripods.scene, stance_instants(lab, row, at)).as_published()
            solved = solve_forces(statement, "clarabel", 16)
            ok = np.zeros(count, bool)
            ok[np.delete(at, np.concatenate([solved.missing, solved.unbalanced]))] = True
            holds.append(ok)
        exists = bool(holds[0].any() and holds[1].any())
        moved = np.zeros((2, n), bool)
        moved[0, list(limbs)], moved[1] = True, True
        moved[1, list(limbs)] = False
        assert exists == (moved.tobytes() in found), limbs


def test_less_friction_allows_less() -> None:
    counts = [len(search(f"terrain.friction={mu}").sequences()) for mu in (1.0, 0.75, 0.6)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1]


def test_largest_friction_factor_scales_with_friction(tripods: Search) -> None:
    sequence = tripods.sequences()[0]
    stance = np.array([stance_of_move(*sequence.states[1:3])])
    pose = np.array([sequence.poses[1]])
    own = largest_friction_factor(tripods.lab, stance, pose)[0]
    half = search("terrain.friction=0.5")
    assert largest_friction_factor(half.lab, stance, pose)[0] == pytest.approx(own / 2, rel=1e-2)


def test_a_sequence_asked_for_is_the_only_kind() -> None:
    found = search("task.rounds=3", "task.sequence=1-2-3", "search.heights=3")
    names = [found.name(s) for s in found.sequences()]
    assert names
    assert all(name.startswith("1-2-3:") for name in names)
