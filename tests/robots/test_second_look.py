"""The second method of `bench zoo`: weak motors are told in N m, strong ones are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import Walker

from climbplan.bench.zoo.second.look import looked, second_look, surfaces_of
from climbplan.bench.zoo.second.stances import Limbs, Stance, Surface, anywhere, onto
from climbplan.bench.zoo.second.statics import least_load
from climbplan.robots.urdf.pinocchio_model import urdf_model
from climbplan.robots.urdf.proposal.proposing import legs_of


def limbs_of_walker(folder: Path, effort: float) -> Limbs:
    found = legs_of(Walker(joints=3).write(folder / "walker.urdf"))
    model = urdf_model(found.draft.robot())
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
    stance = Stance(limbs.found.turn, angles, 0.0)
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
    weight = 9.81 * limbs.found.mass()
    upright = gravity - sum(limbs.toe(i)[1].T @ [0, 0, weight / 4] for i in every)
    assert np.abs(upright[:6]).max() < 1e-6 * weight
    least = least_load(limbs, ground, stance, every, 0.0)
    assert least.torque == pytest.approx(np.abs(upright[6:]).max(), rel=1e-6)


@pytest.mark.parametrize(("effort", "verdict"), [(60.0, "found one"), (1.5, "refusal right")])
def test_motors_that_are_too_weak_are_told(tmp_path: Path, effort: float, verdict: str) -> None:
    limbs = limbs_of_walker(tmp_path, effort)
    surfaces, mu = surfaces_of(limbs, (False,) * 4, "ground")
    look = looked(limbs, surfaces, mu, any_limb=False, seed=0, count=8)
    assert look.verdict == verdict
    assert look.reached >= 8
    assert ("N m more than the 1.25 N m that may be used" in look.words) == (effort < 2)


def test_what_is_a_limit_of_ours_is_called_so(tmp_path: Path) -> None:
    path = Walker(joints=3).write(tmp_path / "walker.urdf")
    assert second_look(path, "turn", "no spec: legs", 0).verdict == "limit of ours"
    assert second_look(path, "turn", "the plan is late", 0).verdict == "not looked at"
    two = path.read_text().replace('type="revolute"', 'type="fixed"', 4)
    path.write_text(two)
    look = second_look(path, "ground", "too few", 0)
    assert look.verdict == "limit of ours"
    assert "are a limit of climbplan, not of the robot" in look.words
