"""A bound of a union of tubes: linear programs, ranges drawn closer, and a search over contacts.

The cost of the mixed-integer program is not the true one: envelopes and the tube give it room. Each
gait that it comes up with is therefore priced by the SQP on the nonlinear dynamics, and only such
trajectories are answers.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.walking.check.checker import passes
from climbplan.walking.micp.covering import Leaf, covering, narrow_first
from climbplan.walking.micp.heads import (
    SHORTEST,
    Stated,
    bound_drawn,
    drawn_by_heads,
)
from climbplan.walking.micp.kept import Kept
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.mirror import own_image, with_images
from climbplan.walking.micp.parts import Opened, Part, early_of
from climbplan.walking.micp.relaxed import SAG, linear, relaxed
from climbplan.walking.micp.statement import Relaxation, relaxation
from climbplan.walking.micp.tree import Search
from climbplan.walking.micp.tube import Tube, tube_about
from climbplan.walking.offline.footing import gait_of
from climbplan.walking.offline.gaits import with_regions
from climbplan.walking.offline.sqp import iterate_of, solve_gait
from climbplan.walking.plan.answer import Improvement
from climbplan.walking.task.task import WalkTask, WalkTrajectory

_DRAWING = 0.4  # of the time that is left, for drawing tube and ranges closer
_BRANCHING = 0.3  # of all time, to part tubes
_NEW_START = 0.85  # times the cost before
TANGENTS = 2.0  # each so many times the one before; where they are wanted more come
_SHARES = (0.2, 0.35, 0.5)  # contacts of the relaxed program beyond count as such
ROUNDS = 3  # of drawing ranges of a gait closer
_GAIT = 0.0005  # of the cost, that a head has to raise the bound of a gait by
SAG_SEARCHED = 5.0 * SAG  # of the cost, that squares of a search may be too small
_NODES = 60  # of a brief search
_SPARED = 2e-4  # of the cost, that bounds may lose for smaller programs
_PRICING = 8  # QPs for a gait of the program, and once more to settle
_POLISH = 40


@dataclass
class Bounding:
    """What is known so far, and what is asked next."""

    task: WalkTask  # whose dynamics judge gaits
    stated: WalkTask  # whose relaxation finds them
    limits: MicpLimits
    best: WalkTrajectory
    objective: float
    begin: float
    bounds: list[float] = field(default_factory=lambda: [0.0])  # of each tube; squares cost no less
    at: int = 0  # the tube that is looked at
    share: float = 1.0  # of all time that this tube has
    elsewhere: float = 0.0  # [s] that other processes took meanwhile, where a clock is a process's
    word: str = "time limit"
    again: bool = False
    seen: set[bytes] = field(default_factory=set)
    history: list[Improvement] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        return self.limits.clock() - self.begin + self.elsewhere

    @property
    def bound(self) -> float:
        """Of the union of all tubes."""
        return min(self.bounds)

    @property
    def left(self) -> float:
        return max(self.share * self.limits.seconds - self.seconds, 0.0)

    @property
    def closed(self) -> bool:
        """The tube that is looked at has nothing cheaper by the gap."""
        known = self.bounds[self.at]
        return self.objective - known <= self.limits.gap * self.objective * (1 + 1e-9)

    @property
    def by_wall(self) -> bool:
        """HiGHS can watch the time itself."""
        return self.limits.clock is time.perf_counter

    def quiet(self) -> Any:
        """HiGHS until the time is over: its own limit is by the wall's clock."""
        return linear(self.left if self.by_wall else np.inf)

    def leaves(self, motions: Array) -> list[Leaf]:
        """Tubes about motions (M, N + 1, 12) whose union is bounded from here on."""
        limits, begin = self.limits, self.seconds
        width = np.array(limits.angles), np.array(limits.spin)
        if len(motions) <= 2:  # the start, and what is best
            leaves = [Leaf(tube_about(self.stated, motions, *width), motions, 0.0)]
        else:
            leaves = covering(
                self.stated,
                motions,
                width,
                self.objective * (1.0 - limits.gap),
                self.first_bound,
                lambda: self.seconds < begin + _BRANCHING * (limits.seconds - begin),
            )
        # What was proved of other tubes counts no more.
        self.bounds, self.again = [leaf.bound for leaf in leaves], False
        self.history = [replace(step, bound=0.0) for step in self.history]
        self.note()
        return leaves

    def cover(self, leaves: Sequence[Leaf]) -> None:
        """Bound one tube after the other."""
        # Narrow tubes are through soon: what they leave of their time is for wider ones.
        order = narrow_first(leaves)
        for done, at in enumerate(order):
            used = self.seconds / self.limits.seconds
            self.at, self.share = at, used + (1.0 - used) / (len(leaves) - done)
            self.bounded(leaves[at].tube)
            if self.again:
                break
        self.share, self.at = 1.0, int(np.argmin(self.bounds))

    def first_bound(self, tube: Tube) -> float:
        """The bound of a tube by linear programs."""
        limits, most = self.limits, self.objective * (1.0 - self.limits.gap)
        pieces = limits.arm_pieces, limits.height_pieces
        program = relaxation(self.stated, tube, most, *pieces, TANGENTS)
        found = max((value for value, _ in self.relaxed(program)), default=0.0)
        return min(found, most)

    def note(self) -> None:
        """Keep incumbent and bound of this moment."""
        self.history.append(Improvement(self.seconds, self.objective, self.bound))

    def bounded(self, tube: Tube) -> None:
        """The program of motions that are cheaper by the gap: if there are none, it is closed."""
        part = self.whole(tube)
        opened = self.opened(part)
        if opened is not None:
            self.search(opened.part, opened.program)

    def whole(self, tube: Tube) -> Part:
        """All motions within a tube, and their mirror images where one of two is enough."""
        limits, most = self.limits, self.objective * (1.0 - self.limits.gap)
        width = np.array(limits.angles), np.array(limits.spin)
        both = with_images(tube, *width) if own_image(self.stated) else None
        tube = both if both is not None else tube
        stated = Stated(self.stated, tube, most, limits.arm_pieces, limits.height_pieces, TANGENTS)
        return Part(stated, both is not None, head=min(SHORTEST, early_of(stated)))

    def opened(self, part: Part) -> Opened | None:
        """What linear programs alone tell of a whole tube; None if that is all, or time is over."""
        most = part.stated.most
        there, _ = self.tighten(part.stated.program(None), most)
        if not there or self.left <= 0:
            return None
        stated = self.spared(part.stated)
        program = stated.program(None)
        drawn = drawn_by_heads(stated, program, _DRAWING * self.left, self.limits.clock)
        if drawn is None:
            self.nothing_cheaper(most)
            return None
        program = stated.program(drawn.box)
        there, _ = self.tighten(program, most)
        part = replace(part, stated=stated, bound=self.bounds[self.at])
        return Opened(part, program) if there and self.left > 0 else None

    def spared(self, stated: Stated) -> Stated:
        """The same without the turning of late knots, where that tells nothing of the cost."""
        known = self.bounds[self.at] - _SPARED * self.objective
        for knots in range(early_of(stated) + 1, stated.task.knots):
            less = replace(stated, turned=knots)
            if max((bound for bound, _ in self.relaxed(less.program(None))), default=0.0) >= known:
                return less
        return stated

    def search(self, part: Part, program: Relaxation, briefly: bool = False) -> None:
        """Raise the bound of a part by a search over contacts; program: of all its motions.

        briefly: a few nodes alone, for what halves of ranges do not tell; no gaits are drawn.
        """
        stated = part.stated
        basis, most = self.objective, stated.most

        def goes_on(bound: float) -> bool:
            self.raise_bound(bound, most)
            self.again = self.objective < _NEW_START * basis
            ended = briefly and found.nodes >= _NODES
            return not ended and self.left > 0 and not self.closed and not self.again

        def settled(contacts: BoolArray) -> float:
            program_of = stated.program(program.box.standing(contacts))
            drawn = drawn_by_heads(stated, program_of, self.left, self.limits.clock, _GAIT)
            if drawn is None:
                return most
            return bound_drawn(stated, drawn.box, ROUNDS, lambda: self.left, self.limits.clock)

        kept = Kept(program, SAG_SEARCHED * self.objective, part.images)
        found = Search(
            kept,
            goes_on,
            lambda: self.left if self.by_wall else np.inf,
            (lambda contacts: 0.0) if briefly else settled,
            lambda x: self.consider(program, x),
        )
        found.run()
        model = program.model
        self.word = (
            f"{found.nodes} nodes, {len(model.lower)} variables, {len(kept.binaries)} binaries, "
            f"{kept.count} rows"
        )

    def nothing_cheaper(self, most: float) -> None:
        """No motion costs less than so much."""
        self.raise_bound(most, most)
        self.word = "no motion is cheaper by the gap, by linear programs alone"

    def tighten(
        self, program: Relaxation, most: float, shares: tuple[float, ...] = _SHARES
    ) -> tuple[bool, Array | None]:
        """Tangents where the relaxed program wants to be: a first bound. False if it has no point.

        most: costs that the program holds. With a point, unless time was over before any.
        """
        x: Array | None = None
        for bound, at in self.relaxed(program):
            if at is not None:
                self.raise_bound(bound, most)
            else:
                self.nothing_cheaper(most)
                return False, None
            x = at
        if x is not None:
            for share in shares:
                self.consider(program, x, share)
        return True, x

    def relaxed(self, program: Relaxation) -> Iterator[tuple[float, Array | None]]:
        """Bounds and points of the program without integers, with ever more tangents.

        Infinity and no point if it has none.
        """
        return relaxed(program.model, SAG * self.objective, self.quiet())

    def raise_bound(self, bound: float, most: float) -> None:
        """A bound on motions that cost no more than so much: the others cost more than that."""
        bound = min(bound, most)
        if np.isfinite(bound) and bound > self.bounds[self.at]:
            self.bounds[self.at] = bound
            self.note()

    def consider(self, program: Relaxation, x: Array, share: float = 0.5) -> None:
        """Solve the gait of a point on the true dynamics; share: of a contact that counts."""
        contact, region = program.gait(x, share)
        if (contact.sum(axis=1) < self.task.least_contacts).any():
            return
        contact = np.vstack([contact, contact[-1:]])
        region = np.vstack([region, region[-1:]])
        gait = with_regions(self.task, contact)
        if len(self.task.ground.height) > 1:
            gait = gait_of(contact, np.where(region >= 0, region, gait.region))
        if gait.key in self.seen:
            return
        self.seen.add(gait.key)
        for start in (None, iterate_of(self.best, gait)):
            found = solve_gait(self.task, gait, start, _PRICING)
            if found.trajectory is None or found.objective >= self.objective:
                continue
            settled = solve_gait(self.task, gait, iterate_of(found.trajectory, gait), _POLISH)
            if settled.trajectory is None or settled.objective >= self.objective:
                continue
            if settled.holds and passes(self.task, settled.trajectory):
                self.best, self.objective = settled.trajectory, settled.objective
                self.note()
