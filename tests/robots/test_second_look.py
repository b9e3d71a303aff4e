"""The second method of benchmark `zoo`: weak motors are told in N m, strong ones are found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker

from benchmarks.zoo.second.look import (
    Look,
    limit_of_walks,
    looked,
    second_look,
    surfaces_of,
)
from benchmarks.zoo.second.room import parts_of_weight, roomiest
from benchmarks.zoo.second.stances import Limbs, Stance, Surface, anywhere, onto, reached
from benchmarks.zoo.second.statics import least_load
from benchmarks.zoo.second.subject import Subject, subject_of
from benchmarks.zoo.second.to_walls import Held, orders_to_walls
from benchmarks.zoo.second.unproposed import all_right, unproposed
from climbplan.errors import UsageError
from climbplan.robots.urdf.pinocchio_model import build_urdf_model
from climbplan.robots.urdf.proposal.propose_robot import detect_legs


def limbs_of_walker(folder: Path, effort: float) -> Limbs:
    found = detect_legs(Walker(joints=3).write(folder / "walker.urdf"))
    model = build_urdf_model(found.draft.load_robot())
    return Limbs(model, {j.name: effort for own in model.robot.joints.values() for j in own})


def test_drawn_toes_are_on_their_surfaces(tmp_path: Path) -> None:
    limbs = limbs_of_walker(tmp_path, 60.0)
    rng = np.random.default_rng(0)
    for column, axis in (("chimney", 0), ("ground", 2)):
        surfaces, _ = surfaces_of(limbs, (False,) * 4, column)
        found = [onto(limbs, surfaces, *anywhere(limbs, rng)) for _ in range(30)]
        whole = [stance for stance in found if stance.missed == 0]
        assert len(whole) > 5
        for stance in whole:
            limbs.placed(stance.turn, stance.angles)
            toes = np.array([limbs.toe(limb)[0] for limb in range(4)])
            for side in {surface.side for surface in surfaces}:
                own = [i for i, surface in enumerate(surfaces) if surface.side == side]
                assert np.ptp(toes[own, axis]) < 3e-6


def test_loads_are_pinocchios_own_statics(tmp_path: Path) -> None:
    """Motors twice as strong need half the share; upright forces are a quarter of the weight."""
    limbs = limbs_of_walker(tmp_path, 10.0)
    twice = limbs_of_walker(tmp_path, 20.0)
    angles = {j.name: 0.3 for own in limbs.joints for j in own if "yaw" not in j.name}
    angles |= {j.name: 0.0 for own in limbs.joints for j in own if "yaw" in j.name}
    stance = Stance(limbs.found.root_to_base_rotation, angles, 0.0)
    ground = (Surface(2, -1.0),) * 4
    every = (0, 1, 2, 3)
    load = least_load(limbs, ground, stance, every, 0.5)
    assert load.share == pytest.approx(2 * least_load(twice, ground, stance, every, 0.5).share)
    assert load.torque == pytest.approx(load.share * 10.0)
    # Without friction forces are upright, a quarter of the weight each
    q = limbs.placed(stance.turn, stance.angles)
    pin = limbs.found.library
    gravity = np.array(pin.computeGeneralizedGravity(limbs.model, limbs.data, q))
    limbs.placed(stance.turn, stance.angles)
    weight = 9.81 * limbs.found.compute_mass()
    upright = gravity - sum(limbs.toe(i)[1].T @ [0, 0, weight / 4] for i in every)
    assert np.abs(upright[:6]).max() < 1e-6 * weight
    least = least_load(limbs, ground, stance, every, 0.0)
    assert least.torque == pytest.approx(np.abs(upright[6:]).max(), rel=1e-6)


@pytest.mark.parametrize(("effort", "verdict"), [(60.0, "not borne out"), (1.5, "refusal right")])
def test_motors_that_are_too_weak_are_told(tmp_path: Path, effort: float, verdict: str) -> None:
    """Strong ones are shown to hold the robot over a whole round of steps."""
    limbs = limbs_of_walker(tmp_path, effort)
    surfaces, mu = surfaces_of(limbs, (False,) * 4, "ground")
    look = looked(limbs, surfaces, mu, seed=0, count=8)
    assert look.verdict == verdict, look.words
    assert look.reached >= 8
    assert ("N m more than the 1.25 N m that may be used" in look.words) == (effort < 2)
    assert ("a round of 4 steps" in look.words) == (effort > 2)


def test_toes_are_put_where_they_were(tmp_path: Path) -> None:
    """Angles are found again, to a micrometre at the toe, from others nearby; none out of reach."""
    limbs = limbs_of_walker(tmp_path, 60.0)
    angles = {j.name: 0.3 for own in limbs.joints for j in own}
    turn, at = limbs.found.root_to_base_rotation, (0.1, -0.2, 0.3)
    limbs.placed(turn, angles, at)
    goals = {limb: limbs.toe(limb)[0] for limb in range(4)}
    found = reached(limbs, goals, turn, at, dict.fromkeys(angles, 0.2))
    assert found is not None
    limbs.placed(turn, found, at)
    assert max(np.abs(limbs.toe(limb)[0] - goals[limb]).max() for limb in range(4)) < 1e-6
    assert reached(limbs, {0: goals[0] + np.array([0, 0, 5.0])}, turn, at, angles) is None


def subject(folder: Path, effort: float) -> Subject:
    """A walker of a robot file, motors limited there."""
    urdf = Walker(joints=3).write(folder / "walker.urdf")
    limbs = detect_legs(urdf).draft.load_robot().joints
    legs = {
        name: f"{{toe: {own[-1].child.rpartition('_')[0]}_foot, posture_deg: {{}}}}"
        for name, own in limbs.items()
    }
    joints = "".join(
        f"  {j.name}: {{max_torque: {effort}}}\n" for own in limbs.values() for j in own
    )
    draft = detect_legs(urdf).draft
    text = f"kind: robot\nurdf: {urdf}\nbase: {draft.base}\njoints:\n{joints}legs:\n"
    text += "".join(f"  {name}: {{toe: {draft.legs[name]['toe']}}}\n" for name in legs)
    text += "joint_stiffness: 150\nlimb_radius: 0.01\nbody_half_size: [0.05, 0.2, 0.05]\n"
    (folder / "walker.yaml").write_text(text)
    return subject_of(folder / "walker.yaml")


@pytest.mark.parametrize(("effort", "verdict"), [(60.0, "not decided"), (1.5, "refusal right")])
def test_walks_need_room_and_force(tmp_path: Path, effort: float, verdict: str) -> None:
    own = subject(tmp_path, effort)
    assert own.limbs.torque[0][0] == effort
    room = roomiest(own, (Surface(2, -1.0),) * 4, 0, 6)
    assert room.verdict == verdict, room.words
    assert (" N upright" in room.words) == (effort < 2)


def test_four_legs_share_the_weight_as_a_lever_does() -> None:
    toes = np.array([[0.1, 0.3, 0], [0.1, -0.1, 0], [-0.1, -0.1, 0], [-0.1, 0.3, 0]])
    assert parts_of_weight(toes) == pytest.approx([0.25, 0.75, 0.75, 0.25])
    assert not parts_of_weight(toes + np.array([0, 0.2, 0])).any()  # all toes ahead


def test_what_is_a_limit_of_ours_is_called_so(tmp_path: Path) -> None:
    ours = limit_of_walks("no spec: walking is of four, six or eight legs, got 5")
    assert ours is not None
    assert ours.verdict == "limit of ours"
    assert limit_of_walks("no spec: toes have no room to walk") is None
    path = Walker(joints=3).write(tmp_path / "walker.urdf")
    path.write_text(path.read_text().replace('type="revolute"', 'type="fixed"', 4))
    with pytest.raises(UsageError, match="are a limit of climbplan, not of the robot") as refused:
        detect_legs(path)
    look = unproposed(path, "ground", str(refused.value), 0)
    assert look.verdict == "limit of ours"
    assert "moves in 2 of 3 directions" in look.words


def test_orders_to_walls_end_where_no_limb_can_leave_the_ground() -> None:
    """Limb 2 may be the last to leave; before it, with limb 2 on the ground, none may."""
    walls = (Surface(0, -1.0), Surface(0, 1.0), Surface(0, 1.0))
    stance = Stance(np.eye(3), {}, 0.0)
    asked: list[tuple[bool, ...]] = []

    def drawn(leave: set[int]) -> Callable[[tuple[Surface, ...], tuple[int, ...]], Held]:
        def held(surfaces: tuple[Surface, ...], lifted: tuple[int, ...]) -> Held:
            there = tuple(s.axis == 0 for s in surfaces)
            asked.append(there)
            assert lifted == tuple(i for i in range(3) if there[i])
            return {i: (0.5 if i in leave or sum(there) == 1 else 2.0, stance) for i in lifted}

        return held

    ends = orders_to_walls(walls, drawn({2}), 0.8, lambda _: "short")
    assert ends.order == ()
    assert ends.lacks == "short"
    assert asked == [(True, True, True), (True, True, False)]
    whole = orders_to_walls(walls, drawn({1, 2}), 0.8, lambda _: "short")
    assert whole.order in ((0, 1, 2), (0, 2, 1))


@pytest.mark.parametrize(("effort", "right"), [(60.0, False), (1.5, True)])
def test_ways_to_walls_are_decided(tmp_path: Path, effort: float, right: bool) -> None:
    look = second_look(subject(tmp_path, effort), "wall", 0, 6)
    assert (look.verdict == "refusal right") == right, look.words
    assert ("in no order do limbs leave the ground" in look.words) == right


def test_what_several_ways_say_is_right_where_all_are() -> None:
    right, open_, wrong = (
        Look(verdict, verdict) for verdict in ("refusal right", "not decided", "not borne out")
    )
    assert all_right([right, right]).verdict == "refusal right"
    assert all_right([right, open_]).verdict == "not decided"
    assert all_right([right, wrong]).verdict == "not borne out"
