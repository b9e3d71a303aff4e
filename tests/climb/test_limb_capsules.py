"""Limbs keep obstacles outside their radius: distances, the linearised knee, swings, tightening."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.check.convex import bound_hull_distance
from climbplan.climb.clearance.limbs import (
    INTERPOLATION_MARGIN,
    compute_limb_points,
    compute_link_distances,
    compute_standing_clearance,
    find_limb_shortfall,
)
from climbplan.climb.clearance.swing import (
    LimbSwing,
    SwingBlocked,
    list_swings,
    plan_swing_path,
    plan_swing_paths,
)
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.motion.motion import StageClock, plan_motion
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.postures import statement
from climbplan.climb.postures.limb_shape import linearise_limb
from climbplan.climb.postures.statement import LinearisedRotation, build_limb_polytopes
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_text
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.examples import read_example
from climbplan.terrain.solids import Solid

SceneMaker = Callable[..., ClimbScene]


def beam_scene() -> ClimbScene:
    """The shipped scene with the usual weights and gait, which make close calls at the beam."""
    usual = ["posture.weights.toe=0.01", "task.gait=null"]
    loaded = load_text(read_example("climb_obstacle"), "climb_obstacle", usual)
    return build_scene(loaded.spec, loaded.robot, loaded.source)


def with_obstacle(scene: ClimbScene, solid: Solid) -> ClimbScene:
    return replace(scene, terrain=replace(scene.terrain, obstacles=(solid,)))


def lid(height: float) -> Solid:
    return Solid.from_box("lid", np.array([-0.6, -0.7, height]), np.array([0.6, 0.7, height + 0.1]))


def densely(scene: ClimbScene, swing: LimbSwing, path: Array) -> Array:
    """Joints and toe (S, 4, 3) of the swinging limb, every 2 mm from contact to contact."""
    points = [swing.old, *path, swing.new]
    toes = np.concatenate(
        [
            a + np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / 2e-3))[:, None] * (b - a)
            for a, b in itertools.pairwise(points)
        ]
    )
    com, rpy = (np.broadcast_to(x, toes.shape) for x in (swing.com, swing.rpy))
    stance = com[:, None] + scene.robot.stance_body @ rotation_world_body(swing.rpy).T
    stance[:, swing.limb] = toes
    return compute_limb_points(scene, com, rpy, stance)[:, swing.limb]


def test_link_distances_agree_with_least_distance_programming() -> None:
    rng = np.random.default_rng(3)
    for points in (lid(0.2).vertices, rng.uniform(-0.4, 0.4, (9, 3))):
        solid = Solid.from_points("solid", points)
        starts, ends = rng.uniform(-0.9, 0.9, (2, 200, 3))
        ends[:60] = starts[:60] + np.eye(3)[rng.integers(0, 3, 60)] * 0.4
        exact = np.array(
            [
                bound_hull_distance(np.stack(x), solid.vertices)
                for x in zip(starts, ends, strict=True)
            ]
        )
        found = compute_link_distances(solid, starts, ends)
        apart = exact > 1e-9
        assert 20 < apart.sum() < 200
        np.testing.assert_allclose(found[apart], exact[apart], atol=1e-8)
        assert (found[~apart] <= 1e-8).all()
        bounded = compute_link_distances(solid, starts, ends, max_distance=0.05)
        assert (bounded <= found + 1e-12).all()
        np.testing.assert_array_equal(bounded >= 0.05, found >= 0.05)


def test_the_statement_holds_the_knee_to_first_order() -> None:
    scene = beam_scene()
    rotation = LinearisedRotation((0.0, 0.0, 0.0))
    rng = np.random.default_rng(1)
    solid, keep = scene.terrain.obstacles[0], 0.03
    for limb in range(scene.robot.limb_count):
        shape = linearise_limb(scene, limb, rotation.reference)
        faces = build_limb_polytopes(solid, shape, keep, keep, rotation)
        for size, error in ((1e-3, 5e-4), (0.03, 0.015)):
            com, rpy = rng.uniform(-size, size, (2, 40, 3))
            turned = rotation_world_body(rpy)
            toes = com[:, None] + np.einsum("kab,nb->kna", turned, scene.robot.stance_body)
            toes[:, limb] += rng.uniform(-size, size, (40, 3))
            knee = compute_limb_points(scene, com, rpy, toes)[:, limb, 2]
            lifted = toes.copy()
            inward = -np.sign(scene.robot.stance_body[limb, 0]) * np.array([1.0, 0, 0])
            lifted[:, limb] += scene.spec.trajectory.swing_clearance * inward
            knee_lifted = compute_limb_points(scene, com, rpy, lifted)[:, limb, 2]
            x = np.hstack([toes[:, limb], com, rpy])
            x = np.hstack([x, x])
            for face, normal, offset in zip(faces, solid.A, solid.b, strict=True):
                slack = face.b[2] - x @ face.A[2]
                true = np.minimum(knee @ normal, knee_lifted @ normal) - offset - keep
                reach = np.isfinite(true)
                assert reach.sum() > 10
                np.testing.assert_allclose(slack[reach], true[reach], atol=error)


@pytest.fixture(name="standing")
def _standing(
    demo_scene: ClimbScene, demo_rounds: Rounds, demo_instants: Instants
) -> tuple[ClimbScene, Rounds, Instants]:
    return demo_scene, demo_rounds, demo_instants


def test_standing_limbs_are_measured_at_their_thickness(
    standing: tuple[ClimbScene, Rounds, Instants],
) -> None:
    scene, rounds, instants = standing
    bare = find_limb_shortfall(scene, rounds, instants)
    assert bare is not None
    assert bare.missing < 0
    last = compute_limb_points(scene, instants.com[-1:], instants.rpy[-1:], rounds.toes[-1:])
    height = float(last[..., 2].max())
    short = find_limb_shortfall(with_obstacle(scene, lid(height + 0.02)), rounds, instants)
    assert short is not None
    assert short.missing == pytest.approx(
        scene.robot.limb_radius + INTERPOLATION_MARGIN - 0.02, abs=1e-9
    )
    assert short.obstacle == "lid"
    assert short.where.startswith("round 3, push")
    words = short.describe(scene)
    assert scene.robot.limb_names[short.limb] in words
    assert "6.0 mm too close to 'lid'" in words
    other = replace(scene, robot=replace(scene.robot, limb_radius=0.01))
    thin = find_limb_shortfall(with_obstacle(other, lid(height + 0.02)), rounds, instants)
    assert thin is not None
    assert thin.missing == pytest.approx(0.011 - 0.02, abs=1e-9)


def test_a_swing_without_room_says_what_is_missing(
    standing: tuple[ClimbScene, Rounds, Instants],
) -> None:
    scene, rounds, instants = standing
    swing = list_swings(scene, rounds, instants)[0]
    limb = compute_limb_points(scene, swing.com[None], swing.rpy[None], rounds.toes[:1])[
        0, swing.limb
    ]
    room = scene.robot.limb_radius + INTERPOLATION_MARGIN
    # Room enough while it stands; a lifted toe raises the knee
    under = with_obstacle(scene, lid(float(limb[:, 2].max()) + room + 0.005))
    with pytest.raises(SwingBlocked) as caught:
        plan_swing_path(under, swing)
    said = str(caught.value)
    assert swing.where in said
    assert f"{scene.robot.limb_names[swing.limb]}'s " in said
    assert "'lid'" in said
    assert f"{1e3 * caught.value.shortfall.missing:.1f} mm too close" in said
    above = densely(scene, swing, np.stack([swing.old, swing.new]) + 0.05 * swing.normals)
    needed = float(above[..., 2].max())
    free = with_obstacle(scene, lid(needed + room + 1e-4))
    np.testing.assert_array_equal(plan_swing_path(free, swing), plan_swing_path(scene, swing))


def test_swings_go_round_what_only_their_links_would_touch(
    standing: tuple[ClimbScene, Rounds, Instants],
) -> None:
    scene, rounds, instants = standing
    first = list_swings(scene, rounds, instants)[1]
    aside = np.array([0.0, 0.12, 0.0])
    swing = replace(first, old=first.old - aside, new=first.old + aside)
    straight = plan_swing_path(scene, swing)
    chain = densely(scene, swing, straight)
    # A small block just above the knee at the middle of the swing
    centre = chain[len(chain) // 2, 2] + [0.0, 0.0, 0.02]
    block = Solid.from_box("block", centre - 0.01, centre + 0.01)
    blocked = with_obstacle(scene, block)
    before = compute_link_distances(block, chain[:, :-1], chain[:, 1:]).min()
    assert before < scene.robot.limb_radius
    path = plan_swing_path(blocked, swing)
    after = densely(scene, swing, path)
    assert (
        compute_link_distances(block, after[:, :-1], after[:, 1:]).min() >= scene.robot.limb_radius
    )
    assert len(path) > len(straight)


@pytest.mark.slow
def test_the_climb_round_the_beam_keeps_every_swing_clear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = beam_scene()
    monkeypatch.setattr(
        statement, "_KNEE_TOLERANCE", -0.012
    )  # a statement that asks for too little
    motion = plan_motion(scene, StageClock(lambda stage, fraction: None))
    assert motion.tightenings
    assert all("knee clearance asked" in note and "'beam'" in note for note in motion.tightenings)
    # The bound is that of the statement as it was first: tightening costs little.
    assert motion.posture.bound is not None
    assert motion.posture.objective < 1.02 * motion.posture.bound
    rounds, instants = motion.posture.rounds, plan_instants(scene, motion.posture.rounds)
    short = find_limb_shortfall(scene, rounds, instants)
    assert short is not None
    assert short.missing <= 1e-9
    assert motion.swings is not None
    beam = scene.terrain.obstacles[0]
    for swing, path in zip(list_swings(scene, rounds, instants), motion.swings, strict=True):
        chain = densely(scene, swing, path)
        assert (
            compute_link_distances(beam, chain[:, :-1], chain[:, 1:]).min()
            > scene.robot.limb_radius
        )


def test_limb_clearance_is_kept_beside_the_radius(demo_climb: SceneMaker) -> None:
    wide = demo_climb(**{"posture.limb_clearance": 0.04})
    assert compute_standing_clearance(wide) == pytest.approx(0.04 + wide.robot.limb_radius)
    none = demo_climb(**{"posture.limb_clearance": 0.0})
    assert compute_standing_clearance(none) == pytest.approx(
        INTERPOLATION_MARGIN + wide.robot.limb_radius
    )


@pytest.mark.slow
def test_thicker_limbs_are_planned_further_off() -> None:
    # No other postures for forces, and a robot that the text of the spec does not have
    soft = ("force.min_stiffness_ratio=0.15", "force.min_normal_force=0", "solver.method=micp")
    loaded = load_text(read_example("climb_obstacle"), "climb_obstacle", soft)
    thin, thick = (
        plan_climb(
            replace(loaded, robot=loaded.robot.model_copy(update={"limb_radius": radius}))
        ).objective
        for radius in (0.01, 0.03)
    )
    assert thin < thick


def test_swings_are_those_of_the_motion(standing: tuple[ClimbScene, Rounds, Instants]) -> None:
    scene, rounds, instants = standing
    paths = plan_swing_paths(scene, rounds, instants)
    assert len(paths) == rounds.count * scene.robot.limb_count
    moves = list_swings(scene, rounds, instants)
    np.testing.assert_array_equal(moves[-1].new, rounds.toes[-1, moves[-1].limb])
    np.testing.assert_array_equal(moves[0].old, rounds.toes[0, moves[0].limb])
