"""The search over stance sets: all sequences, checked by other means."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from climbplan.arrays import IntArray
from climbplan.climb.forces.statement import build_force_statement
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.footholds import GOAL, START
from climbplan.climb.transition.planner import plan_transition
from climbplan.climb.transition.pose_paths import get_stance
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.search import SequenceSearch
from climbplan.climb.transition.stance_forces import (
    LIFTED,
    SearchTables,
    build_stance_instants,
    find_max_friction_factor,
)
from climbplan.errors import Unresolved
from climbplan.robots.rotations import skew

SPECS = Path(__file__).parents[3] / "specs"
FLAT = SPECS / "transition_flat.yaml"


def search(*overrides: str) -> SequenceSearch:
    return SequenceSearch(build_transition(load_transition(FLAT, overrides)))


@pytest.fixture(scope="module")
def tripods() -> SequenceSearch:
    found = search()
    found.list_sequences()
    return found


def test_two_tripod_sequences(tripods: SequenceSearch) -> None:
    found = tripods.list_sequences()
    assert {tripods.format_name(s) for s in found} == {
        "3-3: RF RR LM | RM LR LF",
        "3-3: RM LR LF | RF RR LM",
    }
    assert [s.cost for s in found] == sorted(s.cost for s in found)


def test_more_tripods_balance_on_an_edge() -> None:
    """Limbs that touch without load: the body is on the line between two others."""
    edges = search("search.min_load=0")
    assert len(edges.list_sequences()) == 14


def test_every_limb_moves_once_and_safety_is_as_asked(tripods: SequenceSearch) -> None:
    asked = tripods.scene.spec.force
    for sequence in tripods.list_sequences():
        assert (sequence.moves.sum(axis=0) == 1).all()
        assert sequence.safety_torque >= asked.safety_torque
        assert sequence.safety_friction >= asked.safety_friction * 0.99
        assert sequence.poses[0] == 0
        assert sequence.poses[-1] == tripods.tables.poses.count - 1


def linear_oracle(tables: SearchTables, stance: IntArray, pose: int) -> bool:
    """Admissible forces exist: a linear program of its own on pyramids of 32 sides."""
    scene = tables.scene
    st = build_force_statement(scene, build_stance_instants(tables, stance[None], np.array([pose])))
    limbs = np.flatnonzero(stance != LIFTED)
    rows, ends = [], []
    balance = np.zeros((6, 3 * len(limbs)))
    for k, i in enumerate(limbs):
        at = slice(3 * k, 3 * k + 3)
        balance[:3, at], balance[3:, at] = np.eye(3), skew(st.arms[0, i])
        normal = st.normal[0, i]
        side = np.cross(normal, [0.3, 0.5, 0.8])
        side /= np.linalg.norm(side)
        other = np.cross(normal, side)
        block = [-normal]
        least = [-scene.spec.search.min_load * scene.robot.weight]
        for angle in np.linspace(0, 2 * np.pi, 32, endpoint=False):
            direction = np.cos(angle) * side + np.sin(angle) * other
            block.append(direction - np.cos(np.pi / 32) * st.usable_mu[0, i] * normal)
            least.append(0.0)
        for joint in range(3):
            torque = st.jacobian[0, i, :, joint]
            limit = st.max_torque[i, joint] / st.min_safety_torque
            block += [torque, -torque]
            least += [limit, limit]
        wide = np.zeros((len(block), 3 * len(limbs)))
        wide[:, at] = block
        rows.append(wide)
        ends += least
    answer = linprog(
        np.zeros(3 * len(limbs)),
        A_ub=np.vstack(rows),
        b_ub=ends,
        A_eq=balance,
        b_eq=-st.load[0],
        bounds=(None, None),
    )
    return bool(answer.status == 0)


def test_no_sequence_is_missed(tripods: SequenceSearch) -> None:
    """Every tripod at every pose by another program: the search has just those."""
    tables, n = tripods.tables, 6
    found = {s.moves.tobytes() for s in tripods.list_sequences()}
    start, goal = (START,) * n, (GOAL,) * n
    for limbs in itertools.combinations(range(n), 3):
        first = tuple(GOAL if i in limbs else START for i in range(n))
        exists = True
        for a, b in ((start, first), (first, goal)):
            reached = (
                tables.reach.valid[:, np.arange(n), a] & tables.reach.valid[:, np.arange(n), b]
            )
            at = np.flatnonzero(reached.all(axis=1)) if a != start else np.array([0])
            stance = np.array(get_stance(a, b))
            exists = exists and any(linear_oracle(tables, stance, int(p)) for p in at)
        moved = np.zeros((2, n), bool)
        moved[1] = True
        moved[0, list(limbs)], moved[1, list(limbs)] = True, False
        assert exists == (moved.tobytes() in found), limbs


def test_less_friction_allows_less() -> None:
    counts = [len(search(f"terrain.friction={mu}").list_sequences()) for mu in (1.0, 0.6, 0.4)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 2
    assert counts[-1] == 0


def test_largest_friction_factor_scales_with_friction(tripods: SequenceSearch) -> None:
    sequence = tripods.list_sequences()[0]
    stance = np.array([get_stance(*sequence.states[1:3])])
    pose = np.array([sequence.poses[1]])
    own = find_max_friction_factor(tripods.tables, stance, pose)[0]
    half = search("terrain.friction=0.5")
    assert find_max_friction_factor(half.tables, stance, pose)[0] == pytest.approx(
        own / 2, rel=1e-2
    )


def test_a_sequence_asked_for_is_the_only_kind() -> None:
    found = search("task.rounds=3", "task.sequence=1-2-3", "search.heights=3")
    names = [found.format_name(s) for s in found.list_sequences()]
    assert names
    assert all(name.startswith("1-2-3:") for name in names)


@pytest.mark.slow
def test_smooth_bricks_are_refused_in_forces() -> None:
    """The slip of Fig. 5.15: LF and LR on the bricks, by how much."""
    sequence = "task.sequence=LF LR RM | RF RR LM | LF LR RM"
    loaded = load_transition(SPECS / "transition_bricks_4.yaml", ["task.rounds=3", sequence])
    with pytest.raises(Unresolved) as caught:
        plan_transition(loaded)
    message = str(caught.value)
    assert "round 2, RF RR LM lifted" in message
    assert "LF slips on 'front brick'" in message
    assert "LR slips on 'rear brick'" in message
    assert "has 0.30" in message


def test_limbs_that_cannot_step_so_far_need_the_bricks() -> None:
    loaded = load_transition(
        SPECS / "transition_bricks.yaml", ["task.sequence=3-3-3", "search.between=none"]
    )
    assert SequenceSearch(build_transition(loaded)).list_sequences() == []
