"""Methods that take integers from solved scenes: convex programs at neighbours' integers."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

from climbplan.bookshelf.answer import SceneAnswer
from climbplan.bookshelf.methods.features import Features
from climbplan.bookshelf.methods.scene_method import SceneMethod
from climbplan.bookshelf.methods.statement import Judge, Starts
from climbplan.bookshelf.points import features_of, theta_of
from climbplan.bookshelf.scene import Array, Scene
from climbplan.learning.strategy import Strategy
from climbplan.methods.pipeline import (
    Check,
    Checked,
    PipelineOptions,
    PipelineResult,
    run_pipeline,
)
from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import ConvexBackend
from climbplan.solvers.sqp.method import SqpOptions


@dataclass(frozen=True)
class Convex:
    """All integers from candidates, then a local SQP each; the best that holds wins.

    refinements: quadratic programs a candidate at most; 0 for the published method, one convex
    program over the envelopes about the candidate.
    """

    judge: Judge
    strategy: Strategy
    candidates: int
    refinements: int
    backend: ConvexBackend
    seconds: float
    gap_mm2: float  # a placement that costs no more ends the search
    features: Features = features_of
    name: str = "neighbours"

    def solve(self, scene: Scene) -> SceneAnswer:
        """The best placement of all candidates."""
        begin = time.perf_counter()
        return answer_of(self.judge, scene, self.tried(scene), begin, self.name)

    def tried(self, scene: Scene) -> PipelineResult:
        """What became of each candidate."""
        theta = theta_of(scene)
        instance = self.judge.program.at(theta)
        options = PipelineOptions(
            local="sqp" if self.refinements else "envelopes",
            sqp=SqpOptions(backend=self.backend, steps=max(self.refinements, 1)),
            good_enough=self.gap_mm2,
            time_limit=self.seconds,
        )

        return run_pipeline(
            instance,
            self.strategy.candidates(self.features(theta), self.candidates),
            options,
            check_of(self.judge, scene),
        )


def check_of(judge: Judge, scene: Scene) -> Check:
    """The exact check of the meaning, for points of the statement."""

    def check(instance: Instance, x: Array) -> Checked:
        judged = judge.judge(scene, x)
        return Checked(judged.placement is not None, judged.objective, x, judged.word)

    return check


def answer_of(
    judge: Judge, scene: Scene, found: PipelineResult, begin: float, name: str
) -> SceneAnswer:
    """What a pipeline found, and which candidate won; begin: `time.perf_counter` seconds."""
    judged = None if found.x is None else judge.judge(scene, found.x)
    placed = judged is not None and judged.placement is not None
    tried = len(found.tried)
    word = f"none of {tried} candidates of {name} holds"
    if placed:
        held = sum(t.passed for t in found.tried)
        word = f"candidate {found.winner + 1} of {tried} of {name} won, {held} held"
    return SceneAnswer(
        status="feasible" if placed else "limit",
        placement=judged.placement if judged is not None else None,
        objective=judged.objective if judged is not None else math.inf,
        bound=-math.inf,
        seconds=time.perf_counter() - begin,
        nodes=sum(t.programs for t in found.tried),
        candidates=tried,
        word=word,
    )


@dataclass(frozen=True)
class WithFallback:
    """One method, and another for scenes in which it finds no placement.

    What the other one finds counts only if it holds in the judge's meaning.
    """

    first: SceneMethod
    other: SceneMethod
    judge: Judge

    def solve(self, scene: Scene) -> SceneAnswer:
        """The first method's placement, or whatever the other one says."""
        answer = self.first.solve(scene)
        if answer.placement is not None:
            return answer
        spare = self.other.solve(scene)
        if spare.placement is not None:
            judged = self.judge.judge_placement(scene, spare.placement)
            if judged.placement is None:
                return replace(answer, word=f"{answer.word}; `exact`: {judged.word}")
        return replace(
            spare,
            seconds=answer.seconds + spare.seconds,
            candidates=answer.candidates,
            word="; ".join(filter(None, (answer.word, "answered by `exact`", spare.word))),
        )


def neighbours_start(strategy: Strategy, most: int) -> Starts:
    """Points of the nearest solved scenes, each strategy once."""

    def starts(judge: Judge, scene: Scene) -> list[Array]:
        near = strategy.candidates(features_of(theta_of(scene)), most)
        return [candidate.start for candidate in near]

    return starts
