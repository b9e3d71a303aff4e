"""What swings take of motors, and the intervals that walks are proposed with for that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from urdf_walkers import Walker
from walking_urdf import walking_robot

from climbplan.robots.urdf.pinocchio_model import UrdfModel, build_urdf_model
from climbplan.robots.urdf.proposal.walk_document import STANCE_INTERVALS, format_walk_document
from climbplan.robots.urdf.walking_body import WalkingBody, build_walking_body
from climbplan.walking.planner.swing_effort import compute_swing_effort, compute_swing_speed

pytest.importorskip("pinocchio")


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> tuple[UrdfModel, WalkingBody]:
    robot = walking_robot(tmp_path_factory.mktemp("walker"), Walker())
    return build_urdf_model(robot), build_walking_body(robot)


def test_a_leg_that_hangs_takes_what_gravity_asks(
    walker: tuple[UrdfModel, WalkingBody],
) -> None:
    found, body = walker
    chain, pin, model = body.legs.chain, found.library, found.model
    standing = {
        name: float(angle)
        for names, row in zip(chain.names, chain.posture, strict=True)
        for name, angle in zip(names, row, strict=True)
        if name
    }
    hanging = pin.computeGeneralizedGravity(
        model, model.createData(), found.build_configuration(standing)
    )
    at = [[model.idx_vs[model.getJointId(name)] for name in names] for names in chain.names]
    share = np.abs(np.array(hanging)[np.array(at)] / body.legs.max_torque).max()
    slowly = compute_swing_effort(found, body.legs, 0.0, 100.0, 1e-4, STANCE_INTERVALS)
    assert slowly == pytest.approx(share, rel=1e-2)


def test_quick_swings_take_more(walker: tuple[UrdfModel, WalkingBody]) -> None:
    """Beside its weight by the square of the quickness, where a leg lifts on the spot."""
    found, body = walker
    still, slow, quick = (
        compute_swing_effort(found, body.legs, 0.0, step, 0.01, STANCE_INTERVALS)
        for step in (100.0, 0.1, 0.05)
    )
    assert still < slow < quick
    assert (
        compute_swing_effort(found, body.legs, 50.0, 0.2, 0.01, STANCE_INTERVALS) == np.inf
    )  # out of reach


@pytest.mark.parametrize(("effort", "longer"), [(0.2, False), (0.5, True)])
def test_legs_that_are_heavy_for_their_motors_swing_longer(
    walker: tuple[UrdfModel, WalkingBody], effort: float, longer: bool
) -> None:
    body = walker[1]
    body = replace(body, boxes=replace(body.boxes, half=4 * body.boxes.half))
    asked: list[float] = []

    def told(speed: float, step: float, lift: float) -> float:
        asked.append(step)
        return effort * asked[0] / step

    text = format_walk_document(body, "robot.yaml", told)
    step = float(text.partition("dt: ")[2].split()[0])
    assert (step > asked[0] + 1e-3) == longer
    assert step == pytest.approx(asked[-1], abs=1e-3)


def test_slow_joints_swing_within_their_limits(walker: tuple[UrdfModel, WalkingBody]) -> None:
    legs = walker[1].legs
    fast = compute_swing_speed(legs, 0.2, 0.2, 0.02, STANCE_INTERVALS)
    assert compute_swing_speed(legs, 0.1, 0.4, 0.02, STANCE_INTERVALS) == pytest.approx(
        fast / 2, rel=1e-9
    )
    assert compute_swing_speed(legs, 50.0, 0.2, 0.01, STANCE_INTERVALS) == np.inf


def test_a_body_is_as_slow_as_its_joints_need(walker: tuple[UrdfModel, WalkingBody]) -> None:
    body, specs = walker[1], []
    for factor in (0.1, 4.0):
        text = format_walk_document(
            body,
            "robot.yaml",
            lambda *_: 0.0,
            joint_speed=lambda speed, interval, lift, factor=factor: factor * speed,
        )
        specs.append(yaml.safe_load(text)["task"])
    slow, quick = (spec["reference"]["velocity"][0] for spec in reversed(specs))
    assert 0.5 * 0.75 / 4.0 < slow <= 0.75 / 4.0 < quick
    assert specs[1]["dt"] >= specs[0]["dt"]
