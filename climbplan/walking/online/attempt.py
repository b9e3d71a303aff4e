"""One gait tried within a tick: pinned QPs until the nonlinear dynamics bear their answer out.

What is taken is judged by the rollout of its forces in continuous time: it stays within 0.05 m/s
and 0.05 rad of the QP's prediction over 400 ms, and toes stay in their workspace. Friction holds
because the QP's pyramids are inside the cones.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.body import PARTS
from climbplan.walking.kernels.rollouts import borne_out
from climbplan.walking.offline.pinned import Iterate, PinnedProgram
from climbplan.walking.offline.sqp import guess
from climbplan.walking.published.program import PublishedProgram
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory

SPEED_SLACK, ANGLE_SLACK = 0.05, 0.05  # [m/s], [rad] of the rollout over the horizon
REACH_SLACK = 5e-3  # [m]
JOINT_SLACK = 0.01  # of speed limits that joints are beyond
SWUNG_SLACK = 0.015  # [m] likewise between knots, where legs let go a little farther out
# Slacks that body and toes may miss by after a first QP for a second one to be worth while, with
# intervals of 0.08 s: what a linearised interval neglects grows by its square.
HOPELESS = 20.0 / 0.08**2  # [1/s^2]
ASSEMBLY = 60  # DAQP iterations that take as long as a QP's assembly and check
_MOST_STEPS = 500  # DAQP iterations of a QP
_KEPT = 256  # programs of gaits


@dataclass(frozen=True)
class Attempt:
    """A gait's trajectory, and by how many of the slacks it misses them."""

    trajectory: WalkTrajectory
    excess: float  # <= 0 if it holds
    cost: float  # of its states, eq. (8.30), if it holds; else infinite
    far: bool  # body or toes are so far off that a further QP does not mend it

    @property
    def holds(self) -> bool:
        """The nonlinear dynamics bear it out."""
        return self.excess <= 0.0


@dataclass
class Budget:
    """Work that a tick may still do, in DAQP iterations; a QP's assembly counts as so many."""

    most: int
    done: int = 0
    qps: int = 0

    @property
    def left(self) -> int:
        """Iterations that may still be made."""
        return self.most - self.done

    @property
    def spent(self) -> bool:
        """No further QP fits."""
        return self.left <= ASSEMBLY

    def book(self, iterations: int) -> None:
        """A QP was solved."""
        self.qps += 1
        self.done += iterations + ASSEMBLY


@dataclass
class Progress:
    """QPs of a gait within a tick: where they led, and the best that they came to."""

    here: Iterate  # to linearise about next
    best: Attempt | None = None
    qps: int = 0  # with an answer
    stuck: bool = False  # none within the workspace
    softly: bool = False  # the last one left it

    @property
    def holds(self) -> bool:
        """The best does."""
        return self.best is not None and self.best.holds


class GaitTrials:
    """Programs of gaits, kept from tick to tick."""

    def __init__(self, task: WalkTask, margin: float, beside: float = 0.0) -> None:
        """margin: as of `PinnedProgram`; beside: as of `PublishedProgram`."""
        self._margin, self._beside = margin, beside
        self._programs: OrderedDict[bytes, PinnedProgram] = OrderedDict()
        self._published: OrderedDict[bytes, PublishedProgram] = OrderedDict()

    def program(self, task: WalkTask, gait: Gait) -> PinnedProgram:
        """The program of a gait from the task's start."""
        program = self._programs.get(gait.key)
        if program is None:
            program = PinnedProgram(task, gait, self._margin)
            self._programs[gait.key] = program
            if len(self._programs) > _KEPT:
                self._programs.popitem(last=False)
        else:
            self._programs.move_to_end(gait.key)
            program.begin(task)
        return program

    def begun(self, task: WalkTask, program: PinnedProgram, at: Iterate | None) -> Progress:
        """No QP of a gait yet; at: what to linearise about, an even motion if None."""
        return Progress(guess(task, program.gait) if at is None else fitting(task, program, at))

    def attempt(
        self,
        task: WalkTask,
        program: PinnedProgram,
        progress: Progress,
        iterations: int,
        budget: Budget,
        elastic: bool = False,
    ) -> Attempt | None:
        """The gait's best trajectory after up to so many QPs, fewer if one holds; None without one.

        Those of `progress` count, and are not solved again. elastic: as of `PinnedProgram.step`,
        and what is far off is given up only if it leaves the workspace, too.
        """
        if progress.stuck and not elastic:
            return progress.best
        while progress.qps < iterations and not progress.holds:
            most = min(_MOST_STEPS, budget.left - ASSEMBLY)
            if most <= 0:
                break
            found = program.step(progress.here, elastic, progress.stuck or progress.softly, most)
            budget.book(program.spent)
            progress.stuck, progress.softly = found is None, program.softly
            if found is None:
                break
            progress.qps += 1
            progress.here = found
            judged = self.judged(task, program, found)
            best = progress.best
            if judged is not None and (best is None or judged.excess <= best.excess):
                progress.best = judged
            far = judged is None or judged.far
            if far and (program.softly or not elastic):
                break
        return progress.best

    def published(
        self, task: WalkTask, program: PinnedProgram, at: Iterate, budget: Budget
    ) -> Attempt | None:
        """The published program's answer in the regions of a motion; None where OSQP has none."""
        key = program.gait.key
        if key not in self._published:
            self._published[key] = PublishedProgram(program, self._beside)
            if len(self._published) > _KEPT:
                self._published.popitem(last=False)
        self._published.move_to_end(key)
        answer = self._published[key].solve(fitting(task, program, at))
        budget.book(0)
        return None if answer.at is None else self.judged(task, program, answer.at)

    def judged(self, task: WalkTask, program: PinnedProgram, at: Iterate) -> Attempt | None:
        """The rollout of an iterate's forces in continuous time against its own states."""
        body = task.body
        program.find_heights(at.state)
        state, toes, speed, angle, reach, between = borne_out(
            body.mass,
            body.gravity,
            body.inertia,
            body.inverse,
            body.toe_center,
            body.toe_half,
            program.steps,
            PARTS,
            task.whole_stance,
            program.gait.contact,
            program.footing.foothold,
            program.height,
            program.start.state,
            program.start.toes,
            at.spots,
            program.base,
            program.tilt,
            at.state,
            at.force,
        )
        if math.isinf(speed):
            return None
        off = max(
            speed / SPEED_SLACK,
            angle / ANGLE_SLACK,
            reach / REACH_SLACK,
            between / SWUNG_SLACK,
        )
        hasty = program.joints.too_fast(state, toes, at.spots, program.tilt) / JOINT_SLACK
        excess = max(off, hasty)
        force = np.zeros((len(at.force) + 1, *at.force.shape[1:]))
        force[:-1] = at.force
        cost = program.cost(state, at.force) if excess <= 1.0 else math.inf
        walk = WalkTrajectory(state, toes, force, program.gait)
        return Attempt(walk, excess - 1.0, cost, off - 1.0 > HOPELESS * task.step**2)


def fitting(task: WalkTask, program: PinnedProgram, at: Iterate) -> Iterate:
    """The start with forces and footholds of the legs that stand in this program only."""
    standing = program.gait.contact[:-1]
    force: Array = np.where(standing[..., None], at.force, 0.0)
    spots = at.spots
    if len(spots) != program.footing.count:
        spots = guess(task, program.gait).spots
    if not task.ground.endless:
        spots = task.ground.into(program.footing.region, spots)
    return Iterate(at.state, force, spots)
