"""Bookshelf spec (`kind: bookshelf`): books on a shelf and one more to insert (chapter 8.1).

Lengths are in millimetres here, as their names say: books are that small.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, quantity, refuse
from climbplan.schema.learning.model_file import ModelFileSpec


class BookSpec(SpecModel):
    """A stored book before the insertion."""

    x_mm: Number = quantity("mm", "its centre, to the right of the shelf's middle")
    y_mm: Number | None = quantity(
        "mm", "its centre above the ground; if left out the book stands on the ground", default=None
    )
    tilt_deg: Number = quantity(
        "deg", "angle from upright, > 0 to the left; 90 lies flat", default=0.0, ge=-180, le=180
    )
    height_mm: Number = quantity("mm", "height of the book when upright", gt=0, le=1e5)
    width_mm: Number = quantity("mm", "its thickness", gt=0, le=1e5)


class InsertedSpec(SpecModel):
    """The book to insert."""

    height_mm: Number = quantity("mm", "height of the book when upright", gt=0, le=1e5)
    width_mm: Number = quantity("mm", "its thickness", gt=0, le=1e5)


class ShelfSceneSpec(SpecModel):
    """One scene, written out."""

    books: tuple[BookSpec, ...] = Field(
        min_length=1, description="stored books from left to right; they keep this order"
    )
    insert: InsertedSpec
    """What goes between or beside them, upright or flat."""


class SceneFileSpec(SpecModel):
    """Many scenes in an HDF5 file."""

    file: str = Field(
        min_length=1,
        description="HDF5 file with a dataset `theta`: x, y, angle, height, width of each stored "
        "book, then height and width of the inserted one; relative to the spec",
    )
    group: str = Field(
        default="", description="group that holds `theta`; the only one there is if left out"
    )


class PublishedShelfSpec(SpecModel):
    """Frame and tolerances of the published formulation (formulation `published`)."""

    half_width_mm: Number = quantity("mm", "frame from its middle", default=88.0, gt=0)
    height_mm: Number = quantity("mm", "height of the frame", default=110.0, gt=0)
    distance_tolerance_mm: Number = quantity("mm", "tolerance between points", default=1.5, ge=0)
    sine_tolerance: Number = quantity(
        "", "tolerance on the sine of a state's angle", default=0.05, ge=0
    )
    left_wall_tolerance_mm: Number = quantity(
        "mm", "what a book that leans on the left wall may keep from it besides", default=7.0, ge=0
    )


class ShelfSpec(SpecModel):
    """The shelf, and what counts as touching and as stable (formulation `contact`)."""

    left_mm: Number = quantity("mm", "left wall", default=-81.11)
    right_mm: Number = quantity("mm", "right wall", default=81.11)
    height_mm: Number = quantity("mm", "clear height above the ground", default=110.0, gt=0)
    max_book_gap_mm: Number = quantity(
        "mm", "largest distance at which a leaning book touches a book", default=4.1, ge=0
    )
    max_wall_gap_mm: Number = quantity(
        "mm", "largest distance at which a leaning book touches a wall", default=1.5, ge=0
    )
    lean_margin_deg: Number = quantity(
        "deg",
        "how much more than atan(width / height) a leaning book tilts at least",
        default=0.0,
        ge=0,
        lt=90,
    )
    published: PublishedShelfSpec = PublishedShelfSpec()
    """Frame and tolerances of the published formulation."""

    @model_validator(mode="after")
    def _has_room(self) -> Self:
        if self.left_mm >= self.right_mm:
            message = f"expected more than left_mm {self.left_mm:g}, got {self.right_mm:g}"
            refuse([Fault("right_mm", message)])
        return self


Meaning = Literal["contact", "published"]
ShelfMethod = Literal[
    "exact",
    "minlp-scip",
    "minlp-bonmin",
    "mccormick",
    "mpcc",
    "admm",
    "pinned",
    "knn",
    "forest",
    "boosting",
    "network",
    "reduce",
]


_MIXED_INTEGER, _CONVEX = ("highs", "scip", "gurobi"), ("daqp", "clarabel", "osqp")
_SOLVERS: dict[str, tuple[str, ...]] = {
    "mccormick": _MIXED_INTEGER,
    "admm": _MIXED_INTEGER,
    "pinned": _CONVEX,
    "knn": _CONVEX,
}


class ShelfLibrarySpec(SpecModel):
    """Solved scenes from which methods that learn take their candidates."""

    file: str = Field(
        min_length=1,
        description="a plan file of `solve-bookshelf`, or a dataset of `gen-data`, with as many "
        "stored books; relative to the spec",
    )
    size: Count | None = quantity(
        "", "how many of its scenes to use, the first ones; all if left out", default=None, ge=1
    )
    allow_other_shelves: bool = Field(
        default=False,
        description="also take scenes of another shelf or formulation: every answer is checked on "
        "this shelf in this formulation, but fewer candidates hold",
    )


class ShelfSolverSpec(SpecModel):
    """Which method, and when to stop."""

    method: ShelfMethod = Field(
        default="exact",
        description="`exact`: geometric branch and bound with proved bounds; `minlp-scip`, "
        "`minlp-bonmin`: the whole statement; `mccormick`: piecewise McCormick envelopes on the "
        "published grids; `mpcc`: complementarity; `admm`: alternating between `mccormick` and a "
        "nonlinear program; `pinned`: integers from neighbours, then convex programs; `knn`: "
        "`pinned`, then `exact` if no candidate holds; `forest`, `boosting`, `network`: the same "
        "with integers that a trained model ranks; `reduce`: the reduced mixed-integer program of "
        "the likeliest cluster",
    )
    solver: Literal["highs", "scip", "gurobi", "daqp", "clarabel", "osqp"] | None = Field(
        default=None,
        description="of `mccormick`, `admm` and `reduce`: highs (default), scip, gurobi; of "
        "`pinned`, `knn`, `forest`, `boosting` and `network`: daqp (default), clarabel, osqp",
    )
    start: Literal["zero", "manual", "knn"] = Field(
        default="manual",
        description="where `mpcc` starts: `zero`, `manual` (the scene as it is, planes solved "
        "before) or `knn` (neighbours in the library)",
    )
    max_candidates: Count | None = quantity(
        "",
        "how many candidates to try: 3 for `mpcc`, 50 if left out; of `reduce` how many clusters: "
        "1, and further ones while no placement was found",
        default=None,
        ge=1,
    )
    max_refinements: Count = quantity(
        "",
        "largest number of quadratic programs per candidate of learned methods; 0: the published "
        "method, one pinned program over the envelopes about the neighbour",
        default=30,
        ge=0,
    )
    library: ShelfLibrarySpec | None = Field(
        default=None, description="solved scenes; `mpcc` with start `knn`, `pinned`, `knn` need it"
    )
    model: ModelFileSpec | None = Field(
        default=None,
        description="trained strategy; `forest`, `boosting`, `network`, `reduce` need it, `knn` "
        "takes it in place of a library",
    )
    fallback: bool = Field(
        default=True,
        description="whether `exact` answers scenes in which no candidate of a learned method "
        "holds; `pinned` never asks it",
    )
    gap_mm2: Number = quantity("mm^2", "absolute gap to prove", default=0.01, gt=0)
    gap: Number = quantity(
        "", "relative gap to prove; the looser of both holds", default=1e-4, ge=0
    )
    time_limit: Number = quantity("s", "time limit of one scene", default=10.0, gt=0)
    node_limit: Count = quantity("", "node limit of one scene", default=5_000_000, ge=1)


class BookshelfSpec(SpecModel):
    """Insert one more book with least movement of the stored ones."""

    kind: Literal["bookshelf"] = Field(description="always `bookshelf`")
    title: str = Field(default="", description="one line for reports")
    shelf: ShelfSpec = ShelfSpec()
    """The shelf and its rules."""
    scene: ShelfSceneSpec | None = Field(default=None, description="one scene, written out")
    scenes: SceneFileSpec | None = Field(default=None, description="many scenes in a file")
    formulation: Meaning = Field(
        default="contact",
        description="`contact`: no overlap, leaning books touch their support; `published`: the "
        "published constraints and tolerances",
    )
    solver: ShelfSolverSpec = ShelfSolverSpec()
    """Method and limits."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.scene is None) == (self.scenes is None):
            actual = "got both" if self.scene else "got neither"
            refuse([Fault("", f"expected either `scene` or `scenes`, {actual}")])
        if self.formulation == "published" and self.solver.method == "exact":
            message = "`exact` solves the formulation `contact` only"
            refuse([Fault("formulation", message)])
        method, solver = self.solver.method, self.solver.solver
        allowed = _SOLVERS.get(method, ())
        if solver is not None and solver not in allowed:
            expected = f"expected one of {', '.join(allowed)}" if allowed else "it takes no solver"
            refuse([Fault("solver.solver", f"method `{method}`: {expected}, got {solver!r}")])
        return self
