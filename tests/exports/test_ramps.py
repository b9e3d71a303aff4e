"""Load ramps, controllers on torques, sidecars and latches."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from climbplan.cli.app import run
from climbplan.climb.exports.motion import read_motion as climb_motion
from climbplan.errors import UsageError
from climbplan.exports.damping import critical_damping, update_rate
from climbplan.exports.formats import (
    FORMATS,
    ControllerOptions,
    adapt_motion,
    apply_trajectory_controller_defaults,
)
from climbplan.exports.sampling import add_load_ramps
from climbplan.exports.sidecar import collect_facts
from climbplan.limms.check.loads import compute_loads
from climbplan.limms.exports.motion import GROUND, NO_ANCHOR
from climbplan.limms.exports.motion import read_motion as limms_motion
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.schema.module import ModuleSpec
from climbplan.walking.exports.motion import read_motion as walk_motion


def test_a_ramp_takes_load_and_gives_it_up(plans: dict[str, Path]) -> None:
    rate, ramp = 200.0, 1.5
    plan = adapt_motion(climb_motion(plans["climb"]), ControllerOptions(rate=rate))
    motion = add_load_ramps(plan, ramp)
    joints, own, contacts = motion.joints, plan.joints, motion.contacts
    assert joints is not None
    assert own is not None
    assert contacts is not None
    assert own.link_angle is not None
    count = round(ramp * rate)
    assert motion.time[0] == plan.time[0]
    assert motion.time[-1] == pytest.approx(plan.time[-1] + 2 * ramp)
    assert np.diff(motion.time) == pytest.approx(1 / rate, abs=1e-9)
    inside = slice(count, count + len(plan.time))
    assert np.array_equal(joints.command[inside], own.command)
    for end, link in ((0, own.link_angle[0]), (-1, own.link_angle[-1])):
        assert joints.command[end] == pytest.approx(link, abs=1e-12)
        assert joints.angle[end] == pytest.approx(link, abs=1e-12)
        assert (joints.torque[end] == 0.0).all()
        assert (contacts.force[end] == 0.0).all()
    assert np.ptp(motion.bodies[0].position[:count], axis=0).max() == 0.0
    ramps = np.r_[:count, -count:0]
    torque = joints.gain * (joints.command - joints.angle)
    assert torque[ramps] == pytest.approx(joints.torque[ramps], abs=1e-9)
    moved = (joints.command[2:] - joints.command[:-2]) * rate / 2
    assert np.abs(moved - joints.velocity[1:-1]).max() < 1e-2 * np.abs(joints.velocity).max()
    assert "load ramps" in motion.words[-1]


def test_ramps_that_cannot_be(plans: dict[str, Path]) -> None:
    with pytest.raises(UsageError, match="--ramp 100: expected"):
        adapt_motion(climb_motion(plans["climb"]), ControllerOptions(ramp=100.0))
    for motion in (walk_motion(plans["walk"]), limms_motion(plans["modules"])):
        with pytest.raises(UsageError, match="begins and ends under load"):
            adapt_motion(motion, ControllerOptions(ramp=1.0))


def test_controllers_on_torques_are_fast_and_damped(plans: dict[str, Path], tmp_path: Path) -> None:
    motion = climb_motion(plans["climb"])
    how = apply_trajectory_controller_defaults(motion, ControllerOptions(rate=20.0))
    assert (how.gravity, how.ramp) == (True, 3.0)
    FORMATS["jtc"].write(adapt_motion(motion, how), tmp_path)
    stored = yaml.safe_load((tmp_path / "controllers.yaml").read_text(encoding="utf-8"))
    assert stored["controller_manager"]["ros__parameters"]["update_rate"] >= 500
    own = stored["joint_trajectory_controller"]["ros__parameters"]
    assert all(gain["d"] > 0 for gain in own["gains"].values())
    facts = json.loads((tmp_path / "export.json").read_text(encoding="utf-8"))
    assert facts["ramp_s"] == 3.0
    assert facts["effort_has_gravity"]


def test_update_rates_follow_the_fastest_joint() -> None:
    gain, inertia = np.array([100.0, 100.0]), np.array([0.05, 1e-3])
    damping = critical_damping(inertia, gain)
    assert damping**2 == pytest.approx(4 * gain * inertia)
    # sqrt(K / I) = 316 rad/s, four steps within 1 / that
    assert update_rate(damping, gain) == 1300.0
    assert update_rate(damping[:1], gain[:1]) == 500.0


def test_sidecars_say_what_samples_mean(plans: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "motion.csv"
    asked = ["--rate", "50", "--gains", "rigid", "-o", str(out), "-q"]
    assert run(["export", str(plans["climb"]), *asked]) == 0
    facts = json.loads((tmp_path / "motion.csv.json").read_text(encoding="utf-8"))
    assert facts["euler"] == "R = Rz(yaw) Ry(pitch) Rx(roll), body to world"
    motion = climb_motion(plans["climb"])
    assert motion.joints is not None
    assert motion.joints.limits is not None
    assert [joint["name"] for joint in facts["joints"]] == list(motion.joints.names)
    assert facts["joints"][0]["gain"] == facts["joints"][0]["gain_rigid"]
    assert facts["joints"][0]["gain_rigid"] < motion.joints.gain[0]
    assert facts["base_link"] is None  # a robot without a URDF
    assert len(facts["surfaces"]) == 2
    assert {"torque", "gravity", "effort", "force"} <= set(facts["signs"])


def test_modules_know_when_to_latch(plans: dict[str, Path]) -> None:
    plan, motion = read_limms_plan(plans["modules"]), limms_motion(plans["modules"])
    latches, facts = motion.latches, collect_facts(motion)
    assert latches is not None
    held = latches.anchor.reshape(len(motion.time), -1, 2)
    last = np.append(np.diff(plan.motion.time) > 1e-9, True)
    tips = plan.motion.tip_anchor[last]
    assert np.array_equal(held[..., 1][tips >= 0], tips[tips >= 0])
    assert ((held[..., 0] == GROUND) == (plan.motion.ground_end[last] == 0)).all()
    # Events played one after the other give the samples back
    events: list[dict[str, object]] = facts["latch_events"]  # type: ignore[assignment]
    state = dict.fromkeys(latches.ends, "nothing")
    for k, time in enumerate(motion.time):
        while events and float(str(events[0]["time"])) <= time:
            event = events.pop(0)
            closes = event["event"] == "close"
            state[str(event["end"])] = str(event["anchor"]) if closes else "nothing"
        told_here = [latches.name_of(int(anchor)) for anchor in latches.anchor[k]]
        assert told_here == list(state.values())
    fine = adapt_motion(motion, ControllerOptions(rate=100.0)).latches
    assert fine is not None
    assert set(np.unique(fine.anchor)) <= set(np.unique(latches.anchor)) | {NO_ANCHOR}


def test_torques_of_modules_are_those_that_the_checker_finds(plans: dict[str, Path]) -> None:
    plan, motion = read_limms_plan(plans["modules"]), limms_motion(plans["modules"])
    assert motion.joints is not None
    module = ModuleSpec.model_validate(plan.module)
    largest = max(np.abs(loads.torque).max() for loads in compute_loads(plan, module))
    most = np.abs(motion.joints.torque).max()
    assert 0.5 * largest < most <= largest
    links = collect_facts(motion)["module"]["links"]  # type: ignore[index]
    assert sum(link["mass"] for link in links) == pytest.approx(module.mass)
