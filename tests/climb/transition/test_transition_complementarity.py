"""The program that finds sequences by itself: its points, random starts, boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.check.verification import verify
from climbplan.climb.plan.file import write_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.complementarity import (
    ComplementarityDimensions,
    formulate_complementarity,
)
from climbplan.climb.transition.complementarity_data import build_complementarity_data
from climbplan.climb.transition.homotopy import run_from_start
from climbplan.climb.transition.planner import plan_transition
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.scene import TransitionScene, build_transition
from climbplan.climb.transition.stance_forces import SearchTables
from climbplan.errors import UsageError
from climbplan.robots.symbolic_chains import SymbolicChains

SPECS = Path(__file__).parents[3] / "specs"
FLAT, BRICKS = SPECS / "transition_flat.yaml", SPECS / "transition_bricks.yaml"


def scene_of(path: Path, *overrides: str) -> TransitionScene:
    return build_transition(load_transition(path, list(overrides)))


@pytest.mark.slow
@pytest.mark.parametrize("rounds", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_random_starts_end_at_sequences_that_stand(rounds: int) -> None:
    scene = scene_of(FLAT, f"task.rounds={rounds}")
    found: list[ContactSequence] = []

    def carry(tables: SearchTables, sequence: ContactSequence) -> str:
        assert tables.scene is scene
        found.append(sequence)
        return ""

    starts = [run_from_start(scene, seed, carry) for seed in range(4)]
    assert [start.reason for start in starts] == [""] * 4
    assert all(start.num_complementary == 1 for start in starts)
    for sequence in found:
        counts = sequence.moves.sum(axis=1)
        assert len(counts) == rounds
        assert counts.min() >= 1
        assert counts.max() <= 3
        assert sequence.moves.any(axis=0).all()


def test_a_start_goes_on_after_a_sequence_is_refused() -> None:
    scene = scene_of(FLAT)
    seen: list[bytes] = []

    def carry(tables: SearchTables, sequence: ContactSequence) -> str:
        seen.append(sequence.moves.tobytes())
        return "" if len(seen) == 2 else "not this one"

    start = run_from_start(scene, 0, carry)
    assert start.reason == ""
    assert start.num_complementary >= 2
    assert len(set(seen)) == 2  # never the same twice


def test_the_same_seed_gives_the_same_start() -> None:
    scene = scene_of(FLAT, "task.rounds=3")
    first, again = (run_from_start(scene, 3, lambda tables, sequence: "") for _ in range(2))
    assert (first.num_homotopies, first.iterations) == (again.num_homotopies, again.iterations)


def _outside(scene: TransitionScene, toe: Array, side: int) -> float:
    """Row of one limb's toe after round 1 at a place, all weight on one face of box 1."""
    motion = build_complementarity_data(scene)
    stated = motion.program.formulation
    limb = scene.robot.limb_names.index("LF")
    v = np.clip(np.zeros_like(motion.lower), motion.lower, motion.upper)
    v[stated.place("toe")[0][3 * limb : 3 * limb + 3]] = toe
    weights = np.zeros((motion.shape.limbs * motion.shape.solids, motion.shape.faces))
    weights[:, side] = 1.0
    v[stated.place("face_weight")[0]] = weights.ravel()
    rows = np.array(motion.program.rows(v, stated.theta(motion.parameters))).ravel()
    return float(rows[stated.block("solid.outside")[0][limb * motion.shape.solids]])


def test_toes_keep_out_of_boxes_by_weights_of_faces() -> None:
    scene = scene_of(BRICKS)
    inside = np.asarray(scene.terrain.obstacles[0].vertices.mean(axis=0))
    above = inside + np.array([0.0, 0.0, 0.2])
    for side in range(6):  # no face parts a point inside from the box
        assert _outside(scene, inside, side) < 0
    best = max(_outside(scene, above, side) for side in range(6))
    assert best == pytest.approx(0.2 - 0.045)


def test_rows_bound_only_what_bounds_the_room() -> None:
    scene = scene_of(BRICKS)
    motion = build_complementarity_data(scene)
    stated, surfaces = motion.program.formulation, motion.surfaces
    lower = motion.bounds(stated).row_lower[stated.block("contact.distance")]
    names = [s.name for s in scene.terrain.surfaces]
    bricks = np.isin(surfaces, [names.index("front brick"), names.index("rear brick")])
    np.testing.assert_array_equal(~np.isfinite(lower), np.tile(bricks.ravel(), (3, 1)))


@pytest.mark.slow
def test_bricks_are_stepped_on(tmp_path: Path) -> None:
    overrides = ["solver.method=mpcc", "solver.starts=1"]
    found = plan_transition(load_transition(BRICKS, overrides))
    write_climb(found, tmp_path / "plan.h5")
    verification = verify(tmp_path / "plan.h5")
    assert verification.passed, verification.table()
    names = [s.name for s in found.terrain.surfaces]
    stood = {names[r] for r in found.rounds.region[:, [3, 5]].ravel()}
    assert {"front brick", "rear brick"} <= stood


def test_a_named_sequence_is_not_for_this_method() -> None:
    named = ["solver.method=mpcc", "task.sequence=3-3-3"]
    with pytest.raises(UsageError, match=r"leave `task.sequence` out"):
        plan_transition(load_transition(BRICKS, named))


@pytest.mark.parametrize("solids", [0, 1])
def test_chains_of_three_joints_have_a_program(solids: int) -> None:
    """The side to which such limbs bend is a number, weights of the faces of solids are not."""
    limbs = SymbolicChains(limbs=4, joints=3, redundant=False)
    shape = ComplementarityDimensions(
        2, limbs, surfaces=2, edges=4, solids=solids, faces=6 * solids
    )
    stated = formulate_complementarity(shape)
    assert stated.place("face_weight").shape == (2, 6 * solids * 4)
    assert stated.sizes()["solid.outside"] == 2 * solids * 4
