"""Margins of forces and footholds: kept where they can be, shared where not, told by `verify`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.forces.margins import (
    apply_margins,
    compute_margin_fraction,
    get_margin_request,
    solve_with_margins,
)
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.statement import (
    build_force_statement,
    check_forces,
    compute_contact_torque_ratio,
    compute_free_penetration,
    compute_penetration,
)
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.scene.footing import build_footing
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.margins import NO_MARGINS, MarginsSpec
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import SpecError
from climbplan.robots.kinematics import toe_world
from climbplan.verification.verification import mark_verified

SPECS = Path(__file__).parents[2] / "specs"
NONPARALLEL = SPECS / "climb_nonparallel.yaml"
SHORT = ["task.rounds=2", "task.goal.com=[0, 0, 0.2]", "margins.friction=0.02"]


def with_spec_margins(scene: ClimbScene, margins: MarginsSpec) -> ClimbScene:
    return replace(scene, spec=scene.spec.model_copy(update={"margins": margins}))


def test_forces_keep_all_margins_where_they_can(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    scene = with_spec_margins(demo_scene, MarginsSpec())
    statement = build_force_statement(scene, demo_instants)
    bare = plan_forces(demo_scene, demo_instants).force
    found = solve_with_margins(get_margin_request(scene), statement, "daqp", 16)
    margins = scene.spec.margins
    assert compute_margin_fraction(statement, margins, bare).min() < 0.9
    assert not len(found.solved.missing)
    assert (found.margin_fraction == 1.0).all()
    np.testing.assert_array_equal(
        found.margin_fraction, compute_margin_fraction(statement, margins, found.solved.force)
    )
    whole = check_forces(apply_margins(statement, margins), found.solved.force)
    assert whole.worst.max() < 1e-7
    deep = compute_free_penetration(statement, found.solved.force)[statement.contact]
    assert deep.min() > margins.depth - 2e-4


@pytest.mark.parametrize("solver", ["daqp", "clarabel"])
def test_margins_that_cannot_be_had_are_shared(
    demo_scene: ClimbScene, demo_instants: Instants, solver: str
) -> None:
    """Three times as much pressure as the motors have: still forces, and no worse than without."""
    greedy = MarginsSpec(normal_force=0.9, friction=0.0, depth=0.0, stiffness=0.0)
    scene = with_spec_margins(demo_scene, greedy)
    statement = build_force_statement(scene, demo_instants)
    bare = compute_margin_fraction(
        statement, greedy, plan_forces(demo_scene, demo_instants, solver).force
    )
    found = plan_forces(scene, demo_instants, solver)
    assert check_forces(statement, found.force).worst.max() < 1e-7
    assert found.margin_share is not None
    short = found.margin_share < 1.0
    assert short.any()
    assert (found.margin_share >= np.minimum(bare, 1.0) - 1e-6).all()
    assert (found.margin_share > bare + 0.02).any()
    (note,) = found.notes
    assert "fragile" in note
    assert "pressure of" in note


def test_without_margins_forces_are_those_of_least_cost(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    none = plan_forces(with_spec_margins(demo_scene, NO_MARGINS), demo_instants)
    some = plan_forces(with_spec_margins(demo_scene, MarginsSpec()), demo_instants)
    assert none.notes == ()
    assert none.safety_torque.min() > some.safety_torque.min()


def test_free_depth_is_where_commands_put_free_toes(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    statement = build_force_statement(demo_scene, demo_instants)
    found = plan_forces(demo_scene, demo_instants)
    command = found.joint_command
    free = toe_world(demo_scene.robot, demo_instants.com, demo_instants.rpy, command)
    inside = np.einsum("kni,kni->kn", demo_instants.toes - free, demo_instants.normal)
    deep = compute_free_penetration(statement, found.force)
    np.testing.assert_allclose(deep, inside, atol=1e-12)
    # A thousandth of the forces bends limbs along straight lines
    little = 1e-3 * found.force
    np.testing.assert_allclose(
        compute_free_penetration(statement, little),
        compute_penetration(statement, little),
        atol=2e-7,
    )


def test_margins_in_a_word_and_misspelt() -> None:
    assert load_climb(NONPARALLEL, ["margins=none"]).spec.margins == NO_MARGINS
    assert not NO_MARGINS.asked
    with pytest.raises(
        SpecError, match=r"margins.normal_forc: unknown key \(did you mean 'normal_force'"
    ):
        load_climb(NONPARALLEL, ["margins.normal_forc=0.1"])
    with pytest.raises(SpecError, match=r"margins"):
        load_climb(NONPARALLEL, ["margins=all"])


def test_motors_have_a_part_of_their_limits_left(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    statement = build_force_statement(demo_scene, demo_instants)
    bare = compute_contact_torque_ratio(statement, plan_forces(demo_scene, demo_instants).force)
    left = 0.5 * (1 - bare.max())
    for torque, whole in ((left, True), (0.99, False)):
        margins = MarginsSpec(torque=torque)
        scene = with_spec_margins(demo_scene, margins)
        found = solve_with_margins(get_margin_request(scene), statement, "daqp", 16)
        assert not len(found.solved.missing)
        use = compute_contact_torque_ratio(statement, found.solved.force)
        assert bool((use <= 1 - torque + 1e-7).all()) is whole
        assert (1 - use >= found.margin_fraction * torque - 1e-7).all()
        if not whole:
            assert (found.margin_fraction < 0.95).all()


def test_checks_recompute_margins_and_call_a_plan_fragile(tmp_path: Path) -> None:
    standing = plan_climb(load_climb(NONPARALLEL, SHORT))
    kept = verify_plan(standing)
    assert kept.passed
    assert kept.fragile == ()
    names = {check.name for check in kept.checks if check.name.startswith("robust.")}
    assert names == {
        f"robust.{x}" for x in ("normal_force", "friction", "slip", "depth", "torque", "stiffness")
    }
    weak = replace(standing.robot, max_torque=0.55 * standing.robot.max_torque)
    tired = verify_plan(replace(standing, robot=weak)).fragile
    assert len(tired) == 1
    assert "margin 10 % of the limit" in tired[0]
    # The same text on forces that were planned without margins
    bare = plan_climb(load_climb(NONPARALLEL, [*SHORT, "margins=none"]))
    assert not [c for c in verify_plan(bare).checks if c.name.startswith("robust.")]
    swapped = replace(bare, spec_text=standing.spec_text, spec_sha256=standing.spec_sha256)
    found = verify_plan(swapped)
    assert found.passed
    assert found.badge == "verified"
    assert any("mm outside its surface" in words for words in found.fragile)
    assert found.scope()["fragile"] == list(found.fragile)
    path = tmp_path / "plan.h5"
    write_climb(swapped, path)
    mark_verified(path, found)
    with h5py.File(path) as file:
        assert "outside its surface" in file.attrs["fragile"]


def test_toes_keep_off_edges_that_end_something() -> None:
    plan = plan_climb(load_climb(SPECS / "climb_patches.yaml"))
    patch = plan.terrain.surfaces[1]
    low, high = patch.vertices[:, 2].min(), patch.vertices[:, 2].max()
    z = plan.rounds.toes[1:, :, 2]
    off = np.minimum(np.abs(z - low), np.abs(z - high))
    assert off.min() > 0.0099
    assert ((z < low) | (z > high)).all()


def test_edges_with_ground_beyond_stay() -> None:
    """Three rectangles of one wall abut: only the outer edges lose a strip."""
    loaded = load_climb(SPECS / "climb_obstacle.yaml")
    terrain = build_scene(loaded.spec, loaded.robot).terrain
    regions = build_footing(terrain, 0.01)
    lower, middle = regions[0], regions[1]
    assert lower.name == "left lower"
    given = terrain.regions[0]
    strip = given.b - lower.b
    # Above the lower rectangle the middle one covers a part only: the beam has the rest
    assert strip == pytest.approx(np.full(4, 0.01))
    top = int(np.argmax(terrain.regions[1].A[:, 2]))
    assert (terrain.regions[1].b - middle.b)[top] == 0.0
    assert build_footing(terrain, 0.0) == ()


def test_a_transition_keeps_its_margins() -> None:
    plan = plan_transition(load_transition(SPECS / "transition_bricks.yaml"))
    outward = plan.forces.toe_command - plan.instants.toes
    depth = -np.einsum("kni,kni->kn", outward, plan.instants.normal)[plan.instants.contact]
    assert depth.min() > 0.95 * 0.005
    assert verify_plan(plan).fragile == ()


def test_a_surface_may_lack_friction_and_single_rounds_may_ask_for_more() -> None:
    """S_mu of 1.1 covers a lack of 9 %; the margin asks for 35 %. Round 2 presses more."""
    path = SPECS / "transition_flat.yaml"
    bare, kept = (
        plan_transition(load_transition(path, [f"margins.slip={slip}"])) for slip in (0, 0.35)
    )
    mu = kept.instants.mu
    assert (bare.forces.mu_critical / mu).max() > 0.67
    assert (kept.forces.mu_critical / mu).max() < 0.65 + 1e-6
    assert verify_plan(kept).fragile == ()
    checked = {check.name: check for check in verify_plan(kept).checks}
    assert checked["robust.slip"].margin.endswith(", margin 35 %")
    swapped = replace(bare, spec_text=kept.spec_text, spec_sha256=kept.spec_sha256)
    assert any(
        "loss of friction before it slides" in words for words in verify_plan(swapped).fragile
    )
    more = plan_climb(load_climb(NONPARALLEL, [*SHORT, "margins.rounds={2: 2.0}"]))
    pressure = np.einsum("kni,kni->kn", more.forces.force, more.instants.normal)
    least = np.where(more.instants.contact, pressure, np.inf).min(axis=1) / more.robot.weight
    second = more.instants.round == 2
    assert least[second].min() > 0.19
    assert least[~second].min() < 0.19


def test_without_friction_for_the_margin_there_are_forces_all_the_same(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    scene = with_spec_margins(demo_scene, MarginsSpec(slip=0.9))
    found = solve_with_margins(
        get_margin_request(scene), build_force_statement(scene, demo_instants), "daqp", 16
    )
    assert not len(found.solved.missing)
    assert (found.margin_fraction < 1.0).all()
