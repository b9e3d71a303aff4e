"""Datasets of bookshelf scenes (chapter 7.2): books dropped onto a shelf, one taken out.

Published methods, and chapter numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.bookshelf.schema.model import Meaning, ShelfSolverSpec, ShelfSpec
from climbplan.schema.base import Count, Fault, Number, SpecModel, quantity, refuse

Whole = tuple[Count, Count]


class DropSpec(SpecModel):
    """How books are drawn and dropped; the values of X. Lin (UCLA 2022) if left out."""

    width_mm: Whole = quantity("mm", "least and largest width, whole numbers", default=(10, 40))
    height_mm: Whole = quantity("mm", "least and largest height, whole numbers", default=(50, 90))
    max_tilt: Number = quantity("rad", "largest tilt at the start", default=1.2, ge=0, le=1.57)
    frame_width_mm: Number | None = quantity(
        "mm",
        "between the frame's sides, 14 mm more than the shelf's width; if left out the largest "
        "width and 4 mm for each book, the inserted one included",
        default=None,
        gt=20,
    )
    upright_acceptance: Number = quantity(
        "",
        "share kept of the scenes in which every book stands upright: 0.49 makes them a fifth, "
        "as published",
        default=0.49,
        ge=0,
        le=1,
    )
    max_attempts: Count = quantity(
        "", "drops for one scene before its row is given up", default=2000, ge=1, le=1_000_000
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        faults = []
        for name in ("width_mm", "height_mm"):
            low, high = vars(self)[name]
            if not 0 < low <= high <= 10_000:
                faults.append(Fault(name, f"expected 0 < least <= largest, got {[low, high]}"))
        refuse(faults)
        return self


class BookshelfProblemSpec(SpecModel):
    """Books dropped onto a shelf, one taken out, the rest at rest: put it back."""

    kind: Literal["bookshelf"] = Field(description="always `bookshelf`")
    books: Count = quantity("", "stored books", default=3, ge=1, le=12)
    shelf: ShelfSpec | None = Field(
        default=None, description="shelf and rules; if left out the one that books are dropped onto"
    )
    drop: DropSpec = DropSpec()
    """How scenes come about."""
    formulation: Meaning = Field(
        default="contact", description="`contact` or `published`, as of `kind: bookshelf`"
    )
    solver: ShelfSolverSpec = ShelfSolverSpec()
    """Method and limits."""

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        if self.formulation == "published" and self.solver.method == "exact":
            refuse([Fault("formulation", "`exact` solves the formulation `contact` only")])
        return self
