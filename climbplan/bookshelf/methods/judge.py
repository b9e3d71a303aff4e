"""The statement of one meaning and shelf, and the exact check that judges its points."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer, Status
from climbplan.bookshelf.scene.shelf_scene import Scene, Scenes, Shelf, movement_cost
from climbplan.bookshelf.schema.model import Meaning
from climbplan.bookshelf.statement.points import placement_of, theta_of
from climbplan.bookshelf.statement.stated import checked
from climbplan.bookshelf.statement.statement import bookshelf
from climbplan.methods.table import MethodResult
from climbplan.program import Program
from climbplan.program.instance import Instance


@dataclass(frozen=True)
class Judged:
    """A placement that holds, or why there is none."""

    placement: Placement | None
    objective: float  # [mm^2], infinite without a placement
    word: str = ""


class Judge:
    """What every answer of a method goes through."""

    def __init__(self, count: int, shelf: Shelf, meaning: Meaning) -> None:
        self.program: Program = bookshelf(count, shelf, meaning)
        self.count, self.shelf = count, shelf
        self.meaning: Meaning = meaning

    def instance(self, scene: Scene) -> Instance:
        """The numbers of a scene."""
        return self.program.at(theta_of(scene))

    def judge(self, scene: Scene, x: Array) -> Judged:
        """The placement of a point (N,) if the exact check lets it pass."""
        return self.judge_placement(scene, placement_of(self.program, scene, x))

    def judge_placement(self, scene: Scene, placement: Placement) -> Judged:
        """A placement if the exact check lets it pass."""
        placement, check = checked(scene, placement, self.shelf, self.meaning)
        if not check.passed[0]:
            return Judged(None, math.inf, check.explain(0).replace("\n", "; "))
        cost = movement_cost(Scenes.of([scene]), placement.pose[None])
        return Judged(placement, float(cost[0]))

    def answer(self, scene: Scene, found: MethodResult, begin: float) -> SceneAnswer:
        """What a method says of a scene, judged; begin: `time.perf_counter` seconds."""
        result = found.result
        judged = Judged(None, math.inf, _why(found))
        if result.x is not None:
            judged = self.judge(scene, result.x)
        if judged.placement is not None and found.fates:
            held = sum(tried.passed for tried in found.fates)
            word = f"{found.winner} of {found.tried} won, {held} held"
            judged = Judged(judged.placement, judged.objective, word)
        return SceneAnswer(
            status=_status(found, judged),
            placement=judged.placement,
            objective=judged.objective,
            bound=min(result.bound, judged.objective),
            seconds=time.perf_counter() - begin,
            nodes=result.nodes,
            candidates=max(found.tried, 1),
            word=judged.word,
        )


def _status(found: MethodResult, judged: Judged) -> Status:
    if judged.placement is not None:
        return "optimal" if found.result.status == "optimal" else "feasible"
    return "infeasible" if found.result.status == "infeasible" else "limit"


def _why(found: MethodResult) -> str:
    result = found.result
    if found.fates:
        return f"none of {found.tried} candidates of {found.method} holds"
    said = f" ({'; '.join(result.log)})" if result.log else ""
    return f"{result.solver} found none in {result.time:.1f} s{said}"
