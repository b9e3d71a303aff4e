"""Masses of modules: against Pinocchio, against plain statics, and in the checks of a plan."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from limms_scenes import changed, loaded, scene

from climbplan.errors import Infeasible, SpecError
from climbplan.limms.arms.loads import build_load_function
from climbplan.limms.arms.symbols import build_arm_function
from climbplan.limms.check.dense import iterate_stretches
from climbplan.limms.check.kinematics import compute_points
from climbplan.limms.check.limits import LIMITS, MASS_LIMITS
from climbplan.limms.check.loads import compute_loads
from climbplan.limms.check.masses import find_worst_loads
from climbplan.limms.check.newton_euler import (
    compute_demand,
    compute_joint_torques,
    create_rest_motion,
    sum_demand,
)
from climbplan.limms.check.verification import verify, verify_plan
from climbplan.limms.legs.program import FORCE_FRACTION, LegProgram
from climbplan.limms.modules.inertia import build_link_bodies
from climbplan.limms.modules.limbs import build_arm, build_leg, compute_anchor_pose
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.limms_scene import GRAVITY, FramePoses
from climbplan.limms.schema.loading import load_builtin_module, load_limms
from climbplan.limms.schema.module import OF_MASSES, ModuleSpec

MODULE = load_builtin_module("limms")
BODIES = build_link_bodies(MODULE)


def test_links_joints_and_latches_add_up_to_the_module() -> None:
    assert BODIES.mass.sum() == pytest.approx(MODULE.mass)
    assert (BODIES.com >= 0).all()
    assert (BODIES.com <= MODULE.link_lengths).all()
    even = build_link_bodies(MODULE.model_copy(update={"joint_mass": 0.0, "latch_mass": 0.0}))
    np.testing.assert_allclose(even.com, np.array(MODULE.link_lengths) / 2)
    np.testing.assert_allclose(even.mass / even.mass.sum(), np.array(MODULE.link_lengths) / 0.986)


@pytest.mark.parametrize("root", [0, 1])
def test_torques_are_those_of_pinocchio(root: int) -> None:
    pin = pytest.importorskip("pinocchio")
    model = pin.Model()
    joints = [pin.JointModelRZ if k in (0, 3, 5) else pin.JointModelRY for k in range(6)]
    parent = 0
    for k, joint in enumerate(joints):
        height = np.array([0.0, 0.0, MODULE.link_lengths[k]])
        parent = model.addJoint(parent, joint(), pin.SE3(np.eye(3), height), f"j{k}")
        inertia = np.diag([BODIES.transverse_inertia[k + 1]] * 2 + [BODIES.axial_inertia[k + 1]])
        com = np.array([0.0, 0.0, BODIES.com[k + 1]])
        model.appendBodyToJoint(parent, pin.Inertia(BODIES.mass[k + 1], com, inertia), pin.SE3(1))
    data = model.createData()
    rng = np.random.default_rng(3)
    q, v, a = rng.uniform(-2, 2, (3, 20, 6))
    a *= 10
    base = FramePoses(np.zeros((20, 3)), np.tile(np.eye(3), (20, 1, 1)))
    points = compute_points(MODULE, 0, base, q)
    needed = compute_demand(BODIES, points, 0, create_rest_motion(20), v, a)
    if root:  # the same motion, told from its last end
        needed = compute_demand(BODIES, points, 1, needed.ends[1], v, a)
    wrench = rng.uniform(-30, 30, (20, 6))
    torque = compute_joint_torques(needed, points, wrench[:, :3], wrench[:, 3:])
    for k in range(20):
        pin.forwardKinematics(model, data, q[k], v[k], a[k])
        outer = pin.StdVec_Force([pin.Force.Zero() for _ in range(7)])
        at_tip = data.oMi[6].act(pin.SE3(np.eye(3), np.array([0, 0, MODULE.link_lengths[6]])))
        world = pin.SE3(np.eye(3), at_tip.translation)
        outer[6] = data.oMi[6].actInv(world.act(pin.Force(wrench[k])))
        own = pin.rnea(model, data, q[k], v[k], a[k], outer)
        np.testing.assert_allclose(torque[k], own, atol=1e-6)


def test_a_module_that_is_held_level_pulls_down_and_turns_as_a_beam() -> None:
    level = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z along world x
    points = compute_points(MODULE, 0, FramePoses(np.zeros((1, 3)), level[None]), np.zeros((1, 6)))
    needed = compute_demand(BODIES, points, 0, create_rest_motion(1), *np.zeros((2, 1, 6)))
    force, moment = sum_demand(needed, np.zeros((1, 3)))
    np.testing.assert_allclose(force, [[0, 0, MODULE.mass * GRAVITY]])
    starts = np.cumsum([0, *MODULE.link_lengths[:-1]])
    arm = BODIES.mass @ (starts + BODIES.com) * GRAVITY
    np.testing.assert_allclose(moment, [[0, -arm, 0]], atol=1e-12)


def test_checks_with_masses_come_last_in_their_order(throw: LimmsPlan) -> None:
    checks = verify_plan(throw).checks
    assert {check.name for check in checks} == {*LIMITS, *MASS_LIMITS}
    assert [check.name for check in checks][-len(MASS_LIMITS) :] == list(MASS_LIMITS)


def test_a_plan_without_masses_tells_what_they_would_need(throw: LimmsPlan) -> None:
    found = verify_plan(throw)
    assert found.badge == "verified in its model (massless modules)"
    told = [check for check in found.checks if check.name in MASS_LIMITS]
    assert not any(check.judged for check in told)
    needs = [words for words in found.leaves_out if words.startswith("with masses")]
    assert any("latch of A on wall holds 20 N" in words for words in needs)
    assert any("joint" in words and "holds 31 N m" in words for words in needs)
    # The same in numbers, as `verify --json` prints them
    by_name = {check.name: check.as_dict() for check in found.checks}
    assert by_name["load.force"]["holds"] == 20
    assert by_name["load.moment"]["holds"] == pytest.approx(0.7)
    for name in ("load.force", "load.moment", "load.tipping", "load.torque"):
        told_of = by_name[name]
        over = told_of["needed"] - told_of["holds"]
        assert told_of["residual"] == pytest.approx(over)
        assert f"{told_of['needed']:.3g} " in told_of["margin"]
    assert "needed" not in by_name["force.limit"]


def test_the_same_plan_fails_where_masses_count(throw: LimmsPlan) -> None:
    heavy = replace(throw, massless=False)
    failed = {check.name for check in verify_plan(heavy).failed}
    assert {"load.force", "load.moment", "load.tipping", "load.torque"} <= failed
    assert "file.spec_values" in failed  # its spec says massless


def test_loads_of_a_standing_module_are_its_weight(throw: LimmsPlan) -> None:
    module = load_builtin_module("limms_quick")
    first = next(compute_loads(throw, module))
    (ground,) = (k for k, c in enumerate(first.contacts) if c.kind == "ground")
    assert first.wrench[ground, 0, 2] == pytest.approx(module.mass * GRAVITY, rel=1e-6)
    (box,) = (k for k, c in enumerate(first.contacts) if c.kind == "box")
    assert first.wrench[box, 0, 2] == pytest.approx(throw.box_mass[0] * GRAVITY, rel=1e-6)
    assert first.imbalance.max() < 1e-4


def test_a_box_that_one_latch_holds_hangs_on_that_latch(throw: LimmsPlan) -> None:
    module = load_builtin_module("limms_quick")
    held = [
        each
        for each in compute_loads(throw, module)
        if throw.motion.box_mode[each.stretch.first, 0] == 3
    ]
    assert held
    for each in held:
        names = [contact.name for contact in each.contacts]
        (on_box,) = (k for k, name in enumerate(names) if "box" in name)
        (on_wall,) = (k for k, name in enumerate(names) if name == "latch of A on wall")
        stored = throw.motion.force[each.stretch.first, 0].sum(axis=0)
        np.testing.assert_allclose(-each.wrench[on_box, 0, :3], stored, atol=1e-4)
        # The wall bears box and module: never less than their weight less what they gain falling
        lifted = each.wrench[on_wall, :, 2].mean()
        assert lifted > 0.5 * module.mass * GRAVITY


def test_whether_masses_count_is_in_the_file(throw_file: Path, throw: LimmsPlan) -> None:
    assert read_limms_plan(throw_file).massless
    assert throw.massless


def test_joints_and_latches_cannot_outweigh_the_module(tmp_path: Path) -> None:
    text = Path(__file__).parents[2] / "climbplan/robots/modules/limms.yaml"
    own = text.read_text(encoding="utf-8").replace("joint_mass: 0.45", "joint_mass: 0.75")
    (tmp_path / "heavy.yaml").write_text(own, encoding="utf-8")
    spec = changed(tmp_path, "limms_throw", robot="heavy.yaml")
    with pytest.raises(SpecError, match=r"weigh 5.2 kg, the whole module 4.14 kg"):
        load_limms(spec)
    assert loaded("limms_throw").spec.massless


@pytest.mark.parametrize("box_end", [0, 1])
@pytest.mark.parametrize("name", ["limms_throw", "limms_turned"])
def test_loads_in_symbols_are_those_of_the_checker(box_end: int, name: str) -> None:
    own = scene(name)
    size = len(own.start_placement)  # with the yaw of a box that turns
    root = compute_anchor_pose(own, 0, 1 - box_end)
    limb = replace(build_arm(0, 1, root, box_end), branch=(1, 1, 1))
    centre, velocity = (
        np.array([0.65, 0.1, 0.6, 0.4])[:size],
        np.array([0.3, -0.2, 0.5, 1.2])[:size],
    )
    acceleration = np.array([2.0, 1.0, -3.0, 4.0])[:size]
    force, moment = np.array([3.0, -5.0, 12.0]), np.array([0.5, 0.2, -0.7])
    angles_of = build_arm_function(own, limb)
    reference = np.array(angles_of(centre, velocity, np.zeros(6))[0]).ravel()

    def moved(time: float) -> tuple[np.ndarray, np.ndarray]:
        at, speed = centre + velocity * time + acceleration * time**2 / 2, velocity
        found = angles_of(at, speed + acceleration * time, reference)
        return np.array(found[0]).ravel(), np.array(found[1]).ravel()

    angles, rates = moved(0.0)
    turns = (moved(1e-5)[1] - moved(-1e-5)[1]) / 2e-5
    held = FramePoses(limb.fixed_position[None], limb.other_rotation[None])
    points = compute_points(own.module, 1 - box_end, held, angles[None])
    bodies = build_link_bodies(own.module)
    needed = compute_demand(
        bodies, points, 1 - box_end, create_rest_motion(1), rates[None], turns[None]
    )
    fixed = limb.fixed_position[None]
    whole_force, whole_moment = sum_demand(needed, fixed)
    on_box = points.position[:, 7 * box_end]
    wall_force = whole_force + force
    wall_moment = whole_moment + moment + np.cross(on_box - fixed, force)
    last = (-force, -moment) if box_end else (wall_force[0], wall_moment[0])
    torque = compute_joint_torques(needed, points, last[0][None], last[1][None])
    told = build_load_function(own, limb)(centre, velocity, acceleration, reference, force, moment)
    for symbols, numbers in zip(told, (torque, wall_force, wall_moment), strict=True):
        np.testing.assert_allclose(np.array(symbols).ravel(), numbers[0], atol=1e-4)


def test_modules_with_mass_lift_a_box_and_keep_every_limit() -> None:
    plan = plan_limms(loaded("limms_lift_with_mass"))
    found = verify_plan(plan)
    assert found.passed
    assert found.badge == "verified"
    told = {check.name: check for check in found.checks if check.name in MASS_LIMITS}
    assert set(told) == set(MASS_LIMITS)
    assert all(check.judged for check in told.values())
    # With the moment that the published latch holds the same motion is refused
    weak = replace(plan, module={**plan.module, "latch_moment": 0.7})
    assert "load.moment" in {check.name for check in verify_plan(weak).failed}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("limms_walk", ()),
        ("limms_lift_heavy", ("task={allow: [quadruped]}",)),
        ("limms_double_arm", ()),
    ],
)
def test_legs_and_chains_keep_every_limit_on_stronger_hardware(
    name: str, words: tuple[str, ...]
) -> None:
    plan = plan_limms(loaded(name, "massless=false", "robot=limms_carrier", *words))
    assert not plan.massless
    verification = verify_plan(plan)
    assert verification.passed
    judged = {check.name for check in verification.checks if check.judged}
    assert {"load.force", "load.moment", "load.friction", "load.tipping", "load.torque"} <= judged


@pytest.mark.parametrize(
    ("massless", "steps", "share"), [(True, False, 0), (False, False, 0.3), (False, True, 1.0)]
)
def test_with_masses_feet_share_the_box_evenly(massless: bool, steps: bool, share: float) -> None:
    own = replace(scene("limms_walk", "robot=limms_carrier"), massless=massless)
    limbs = [build_leg(side, side, 1, (1, 1, 1)) for side in range(4)]
    most = LegProgram(own, limbs, steps).max_force
    held = own.module.max_force if massless else share * own.weight
    assert most == pytest.approx(FORCE_FRACTION * held)


def test_modules_that_their_contacts_do_not_hold_are_proved_too_heavy() -> None:
    with pytest.raises(Infeasible) as refused:
        plan_limms(loaded("limms_lift_light", "massless=false"))
    (conflict,) = refused.value.conflicts
    assert "a contact holds 20 N, 40.6 N needed: what each of A, B, C, D weighs" in str(conflict)
    assert conflict.remedies[0].key == "massless"


def test_plans_of_before_masses_are_still_verified(throw_file: Path, tmp_path: Path) -> None:
    old = tmp_path / "old.h5"
    shutil.copy(throw_file, old)
    with h5py.File(old, "a") as file:
        del file.attrs["massless"]
        module = json.loads(file.attrs["module"])
        for name in OF_MASSES:
            del module[name]
        file.attrs["module"] = json.dumps(module)
    assert verify(old).badge == "verified in its model (massless modules)"
    with h5py.File(old, "a") as file:
        file.attrs["massless"] = False
    assert verify(old).unsound is not None


def test_absurd_places_are_held_by_nothing(throw: LimmsPlan) -> None:
    far = throw.motion.joint_position.copy()
    far[:, :, :] *= 1e40
    lost = replace(throw, motion=replace(throw.motion, joint_position=far))
    checks = {check.name: check for check in verify_plan(replace(lost, massless=False)).checks}
    assert not checks["load.balance"].passed
    assert "nothing gives" in checks["load.balance"].margin


def test_what_turns_faster_at_once_is_a_blow_that_nothing_gives(throw: LimmsPlan) -> None:
    module = ModuleSpec.model_validate(throw.module)
    assert find_worst_loads(throw, module).select("load.balance").excess < 1e-4
    second = list(iterate_stretches(throw, module))[1]
    rates = throw.motion.joint_velocity.copy()
    rates[second.first, 0, 2] += 0.5
    off = replace(throw, motion=replace(throw.motion, joint_velocity=rates))
    balance = find_worst_loads(off, module).select("load.balance")
    assert balance.excess >= 0.5 - 1e-6
    assert "joint 3 of" in balance.message
    assert balance.where.startswith(f"{second.time[0]:.3f} s")
