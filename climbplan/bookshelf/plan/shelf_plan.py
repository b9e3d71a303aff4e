"""The result of a bookshelf run: scenes, placements, and proved bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.bookshelf.plan.answer import Placement, SceneAnswer
from climbplan.bookshelf.scene.rectangles import compute_separation, find_slots
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf
from climbplan.store.root_attributes import PlanHeader

STATUSES = ("optimal", "feasible", "infeasible", "limit")
NO_STATE = -1  # of every book of a scene without a placement, and its slot


@dataclass(frozen=True)
class Solutions:
    """Solutions of S scenes with n stored books; without a placement poses are NaN, states -1."""

    pose: Array  # (S, n + 1, 3) x [m], y [m], angle [rad], the inserted book last
    state: IntArray  # (S, n + 1) of `BookState`
    slot: IntArray  # (S,) stored books left of the inserted one
    status: tuple[str, ...]  # (S,) of STATUSES
    objective: Array  # (S,) [mm^2] infinite without a placement
    bound: Array  # (S,) [mm^2] minus infinity where nothing is proved
    time: Array  # (S,) [s]
    candidates_tried: IntArray  # (S,)
    nodes: IntArray  # (S,) of a tree, or iterations
    overlap: Array  # (S,) [m] worst penetration, NaN without a placement
    message: tuple[str, ...]  # (S,) why there is no placement, or what deserves a remark

    @classmethod
    def of(cls, scenes: Scenes, answers: Sequence[SceneAnswer]) -> Solutions:
        """Build solutions from checked answers."""
        count, books = len(scenes), scenes.count + 1
        pose = np.full((count, books, 3), math.nan)
        state = np.full((count, books), NO_STATE, np.int64)
        for k, answer in enumerate(answers):
            if answer.placement is not None:
                pose[k], state[k] = answer.placement.pose, answer.placement.state
        placed = np.isfinite(pose).all(axis=(1, 2))
        slot = np.where(placed, find_slots(pose, scenes.sizes), NO_STATE)
        return cls(
            pose=pose,
            state=state,
            slot=slot.astype(np.int64),
            status=tuple(answer.status for answer in answers),
            objective=np.array([answer.objective for answer in answers], float),
            bound=np.array([answer.bound for answer in answers], float),
            time=np.array([answer.seconds for answer in answers], float),
            candidates_tried=np.array([answer.candidates for answer in answers], np.int64),
            nodes=np.array([answer.nodes for answer in answers], np.int64),
            overlap=measure_worst_overlap(scenes, pose),
            message=tuple(_build_message(answer) for answer in answers),
        )

    @property
    def placed(self) -> BoolArray:
        """Mask (S,) of the scenes that have a placement."""
        return np.asarray(np.isfinite(self.pose).all(axis=(1, 2)), bool)

    def placement(self, scene: int) -> Placement | None:
        """Return the placement of a scene, None if it has none."""
        if not self.placed[scene]:
            return None
        return Placement(self.pose[scene], self.state[scene], int(self.slot[scene]))

    def count(self, *status: str) -> int:
        """Count the scenes with one of these statuses."""
        return sum(scene_status in status for scene_status in self.status)


@dataclass(frozen=True)
class Totals:
    """A run as a whole."""

    status: str
    objective: float  # [mm^2] sum over scenes with a placement
    bound: float | None  # [mm^2] of the same scenes; None if one of them has no bound
    gap: float | None  # [mm^2]


@dataclass(frozen=True, kw_only=True)
class ShelfPlan(PlanHeader):
    """A bookshelf run as its plan file keeps it."""

    title: str
    shelf: Shelf
    meaning: str
    method: str
    scenes: Scenes
    solutions: Solutions
    totals: Totals


def compute_totals(solutions: Solutions) -> Totals:
    """Compute one status, cost and bound of all scenes."""
    placed = solutions.placed
    objective = float(solutions.objective[placed].sum())
    bound = float(solutions.bound[placed].sum())
    has_bound = placed.any() and math.isfinite(bound)
    return Totals(
        combine_statuses(solutions.status),
        objective,
        bound if has_bound else None,
        objective - bound if has_bound else None,
    )


def combine_statuses(statuses: Sequence[str]) -> str:
    """Combine statuses: `limit` if one is, `infeasible` if all are, otherwise the weaker one."""
    if "limit" in statuses:
        return "limit"
    if all(status == "infeasible" for status in statuses):
        return "infeasible"
    return "feasible" if "feasible" in statuses else "optimal"


def measure_worst_overlap(scenes: Scenes, pose: Array) -> Array:
    """Measure the deepest penetration of two books (S,) [m]; NaN where the pose is NaN.

    Args:
        scenes: sizes of the books.
        pose: (S, n + 1, 3) x [m], y [m], angle [rad], the inserted book last.
    """
    size = scenes.sizes
    i, j = np.triu_indices(pose.shape[1], 1)
    depth = -compute_separation(pose[:, i], size[:, i], pose[:, j], size[:, j])
    worst: Array = np.maximum(depth.max(axis=1), 0.0)
    return worst


def _build_message(answer: SceneAnswer) -> str:
    if answer.status == "infeasible" and answer.shortage is not None:
        return "; ".join(filter(None, (str(answer.shortage), answer.message)))
    return answer.message
