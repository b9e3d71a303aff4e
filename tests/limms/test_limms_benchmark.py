"""`python -m benchmarks limms`: its tables say what its trials were; times are not judged."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest

from benchmarks.limms.random_jumps import random_jump
from benchmarks.limms.run import (
    LimmsOptions,
    LimmsResult,
    as_json,
    bench_limms,
    write_text,
)
from benchmarks.limms.trial import Trial, attempt
from climbplan.limms.scene.limms_scene import build_scene


@pytest.fixture(scope="module")
def result() -> LimmsResult:
    return bench_limms(LimmsOptions(count=0, methods="modes,admm", scenes=("limms_throw",)))


def test_both_methods_are_measured_on_the_same_scene(result: LimmsResult) -> None:
    assert [trial.method for trial in result.shipped] == ["modes", "admm"]
    assert all(trial.succeeded for trial in result.shipped)
    modes, admm = result.shipped
    assert modes.sequence == admm.sequence
    assert modes.consensus is None
    assert admm.consensus is not None
    assert admm.consensus.good_after is not None
    assert admm.consensus.good_after <= admm.consensus.iterations
    out = io.StringIO()
    write_text(result, out)
    text = out.getvalue()
    assert "4857 (670)" in text  # the published row
    assert f"{admm.sizes['mip_variables']} ({admm.sizes['mip_binaries']})" in text
    assert f"{1e3 * admm.consensus.points:.1f} ({1e3 * admm.consensus.points_most:.0f})" in text
    assert f"{admm.processor_seconds / modes.processor_seconds:.1f}" in text
    json.dumps(as_json(result), allow_nan=False)


def test_plans_of_the_search_are_simulated_beside_it(result: LimmsResult) -> None:
    pytest.importorskip("mujoco")
    modes, admm = result.shipped
    assert admm.replay is None
    played = modes.replay
    assert played is not None
    assert played.holds
    assert played.off < 0.005
    out = io.StringIO()
    write_text(result, out)
    rows = out.getvalue().splitlines()
    row = next(line for line in rows if line.startswith("limms_throw") and "delivered" in line)
    assert row.split()[1:4] == ["limms_quick", str(modes.checks), "pass"]
    assert f"{1e3 * played.off:.1f}, {1e3 * played.off_at_end:.1f}" in row
    assert "the seven scenes: 1 of 1 verified, 1 simulated to the goal" in out.getvalue()
    broken = replace(played, outcome="delivered with 1 contact that did not hold", holds=False)
    weak = LimmsResult((), {}, masses=(replace(modes, replay=broken),))
    out = io.StringIO()
    write_text(weak, out)
    assert "1 of 1 verified, 0 simulated to the goal without a broken latch" in out.getvalue()


@pytest.mark.slow
def test_scenes_with_masses_name_hardware_that_holds() -> None:
    options = LimmsOptions(count=0, methods="masses", scenes=("limms_throw", "limms_relatch"))
    (throw,) = bench_limms(options).masses  # nothing holds the other
    assert throw.succeeded
    assert throw.hardware == "limms_quick_strong"
    assert throw.checks > 50


@pytest.mark.slow
def test_as_published_blocks_stay_further_apart(result: LimmsResult) -> None:
    """A throw in steps of one second: no plan, and the residuals are told."""
    options = LimmsOptions(count=0, methods="admm-published", scenes=("limms_throw",))
    (published,) = bench_limms(options).shipped
    assert published.outcome == "limit"
    assert published.consensus is not None
    improved = result.shipped[1].consensus
    assert improved is not None
    assert published.consensus.box > 10 * improved.box
    out = io.StringIO()
    write_text(LimmsResult((published,), {}), out)
    row = next(line for line in out.getvalue().splitlines() if "admm-published" in line)
    assert f"{1e3 * published.consensus.box:.1f} ({1e3 * published.consensus.box_most:.0f})" in row


def test_failures_are_counted_with_their_reasons() -> None:
    failed = attempt(random_jump(3), "admm", 0.05)
    assert isinstance(failed, Trial)
    assert failed.outcome == "limit"
    out = io.StringIO()
    write_text(LimmsResult((), {"jump": (failed,)}), out)
    assert "0 of 1" in out.getvalue()
    assert "no modes that reach the goal were found within 0.05 s" in out.getvalue()


def test_random_jumps_differ_and_repeat() -> None:
    one, again, other = random_jump(1), random_jump(1), random_jump(2)
    assert one.text == again.text
    assert one.text != other.text
    scene = build_scene(one)
    assert scene.num_modules == 4
    assert scene.goal[2] < scene.box_start[0, 2] + 0.2
