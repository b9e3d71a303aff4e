"""`bench zoo`: robots of a Python package from URDF to verified plans, with no hand work between.

Each URDF goes through what `climbplan new robot --urdf` does: legs, toes, postures and motors are
proposed, a walk on flat ground and a climb between walls are planned and verified, and both plans
are simulated in their nominal world. CPU seconds are from the URDF to the first verified plan.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TextIO

from climbplan.bench.climb.stands import fares
from climbplan.climb.proposed import Outcome, planned_proposal
from climbplan.errors import SpecError, UsageError
from climbplan.robots.urdf.proposal.packaged import package_urdf
from climbplan.robots.urdf.proposal.proposing import propose

PACKAGE = "example-robot-data"
ROBOTS = (
    "a1_description",
    "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_c_simple_description",
    "b1_description/urdf/b1.urdf",
    "go1_description",
    "go2_description",
    "hyq_description",
    "laikago_description",
    "solo_description/robots/solo12.urdf",
    "anymal-kinova.urdf",
    "b1-z1.urdf",
    "solo_description/robots/solo.urdf",
    "centauro_description",
    "g1_29dof_rev_1_0.urdf",
    "icub_description/robots/icub.urdf",
    "talos_reduced.urdf",
)
_QUICK = ("solo_description/robots/solo12.urdf",)


def bench_zoo(quick: bool, out: TextIO) -> None:
    """One line a robot; one robot with `quick`. Raises UsageError without the package."""
    head = f"{'robot':<24}{'mass kg':>8}{'legs':>6}{'CPU s':>7}{'walk':>22}{'climb':>22}"
    print(head, file=out)
    cells = planned = 0
    for part in _QUICK if quick else ROBOTS:
        urdf = package_urdf(f"{PACKAGE}:{part}")
        name = f"{urdf.stem}" if urdf.stem != "anymal" else urdf.parents[1].name[:8]
        begin = time.process_time()
        cells += 2
        try:
            found = propose(urdf)
        except (SpecError, UsageError) as error:
            why = str(error).partition("\n")[0].replace(str(urdf), urdf.name)
            print(f"{name:<24}  refused: {why}", file=out, flush=True)
            continue
        first: list[float] = []

        def told(words: str, begin: float = begin, first: list[float] = first) -> None:
            if "walls" in words and not first:
                first.append(time.process_time() - begin)

        with tempfile.TemporaryDirectory() as folder:
            made = planned_proposal(found, Path(folder), told)
        cpu = (first or [time.process_time() - begin])[0]
        ends = [_end(outcome) for outcome in (made.walk, made.climb)]
        planned += sum(outcome.plan is not None for outcome in (made.walk, made.climb))
        robot = found.robot
        line = f"{name:<24}{robot.mass:>8.1f}{robot.limb_count:>6}{cpu:>7.1f}"
        print(line + "".join(f"{end:>22}" for end in ends), file=out, flush=True)
        for outcome in (made.walk, made.climb):
            if outcome.plan is None:
                print(f"  {outcome}", file=out, flush=True)
    share = f"{100 * planned / cells:.0f} %"
    print(f"{planned} of {cells} walks and climbs planned and verified, {share}", file=out)


def _end(outcome: Outcome) -> str:
    """What became of a spec, and of its plan in MuJoCo."""
    if outcome.plan is None:
        return "refused"
    return fares(outcome.plan, "joints")
