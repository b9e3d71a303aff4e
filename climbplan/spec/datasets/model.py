"""Dataset spec (`kind: dataset`): many sampled problems of one kind, each solved (7.2, 5.2.2)."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from climbplan.spec.base import Count, Fault, Number, SpecModel, quantity, refuse
from climbplan.spec.bookshelf.model import Meaning, ShelfSolverSpec, ShelfSpec
from climbplan.spec.datasets.walks import WalksProblemSpec
from climbplan.spec.fits.envelopes import EnvelopeTerrainSpec
from climbplan.spec.program.model import ProgramSolverSpec

Whole = tuple[Count, Count]


class DropSpec(SpecModel):
    """How books are drawn and dropped; the published numbers if left out."""

    width_mm: Whole = quantity("mm", "least and largest width, whole numbers", default=(10, 40))
    height_mm: Whole = quantity("mm", "least and largest height, whole numbers", default=(50, 90))
    tilt: Number = quantity("rad", "largest tilt at the start", default=1.2, ge=0, le=1.57)
    room_mm: Number | None = quantity(
        "mm",
        "between the frame's sides, 14 mm more than the shelf's width; if left out the largest "
        "width and 4 mm for each book, the inserted one included",
        default=None,
        gt=20,
    )
    upright_kept: Number = quantity(
        "",
        "share kept of the scenes in which every book stands upright: 0.49 makes them a fifth, "
        "as published",
        default=0.49,
        ge=0,
        le=1,
    )
    attempts: Count = quantity(
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
    meaning: Meaning = Field(
        default="contact", description="`contact` or `published`, as of `kind: bookshelf`"
    )
    solver: ShelfSolverSpec = ShelfSolverSpec()
    """Method and limits."""

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        if self.meaning == "published" and self.solver.method == "exact":
            refuse([Fault("meaning", "`exact` solves the meaning `contact` only")])
        return self


class ProgramProblemSpec(SpecModel):
    """A problem of one's own, named by `--problem` on the command line, with its own sampler."""

    kind: Literal["program"] = Field(description="always `program`")
    problem: str | None = Field(
        default=None,
        description="the problem that this spec is written for, as `--problem` names it; never "
        "followed, only compared",
    )
    solver: ProgramSolverSpec = ProgramSolverSpec()
    """Method and limits."""


class TerrainSolverSpec(SpecModel):
    """Branch and bound over parts of the patches."""

    method: Literal["exact"] = Field(
        default="exact", description="`exact`: a posture, or the proof that there is none"
    )
    nodes: Count = quantity(
        "", "of the search, after which a terrain stays undecided", default=300, ge=1
    )
    time_limit: Number = quantity(
        "s",
        "of a row, its draws included; a worker beyond ten times it is ended",
        default=60.0,
        gt=0,
    )


class TerrainsProblemSpec(SpecModel):
    """Random terrains, one patch for each limb: whether the robot can stand on them, and how."""

    kind: Literal["terrains"] = Field(description="always `terrains`")
    robot: str = Field(
        min_length=1, description="built-in robot (`silvia`) or path of a robot YAML"
    )
    terrain: EnvelopeTerrainSpec
    """What terrains are drawn from."""
    share_feasible: Number = quantity(
        "",
        "share of rows for which a feasible terrain is drawn; the others get an infeasible one on "
        "which forces alone would balance",
        default=0.5,
        ge=0,
        le=1,
    )
    attempts: Count = quantity(
        "", "terrains drawn for one row before it is given up", default=5000, ge=1, le=1_000_000
    )
    solver: TerrainSolverSpec = TerrainSolverSpec()
    """Limits."""


ProblemSpec = Annotated[
    BookshelfProblemSpec | ProgramProblemSpec | TerrainsProblemSpec | WalksProblemSpec,
    Field(discriminator="kind"),
]


class DatasetSpec(SpecModel):
    """Sample problems, solve them all, and keep every outcome."""

    kind: Literal["dataset"] = Field(description="always `dataset`")
    title: str = Field(default="", description="one line for reports")
    problem: ProblemSpec
    """What is sampled and solved."""
    count: Count = quantity("", "rows", default=1000, ge=1, le=10_000_000)
    seed: Count = quantity("", "seed; each row has its own below it", default=0, ge=0, le=2**32 - 1)
    shard: Count = quantity(
        "", "rows that are kept in one file until the run is complete", default=100, ge=1, le=10_000
    )
    row_timeout: Number | None = quantity(
        "s",
        "a worker that spends more on one row is taken for hung and ended; ten times the solver's "
        "time limit, and a minute, if left out",
        default=None,
        gt=0,
    )

    @property
    def row_seconds(self) -> float:
        """After so long a row's worker is taken for hung [s]."""
        if self.row_timeout is not None:
            return self.row_timeout
        return 10.0 * self.problem.solver.time_limit + 60.0


class ShelfDatasetSpec(DatasetSpec):
    """A dataset of bookshelf scenes."""

    problem: BookshelfProblemSpec
    """What is sampled and solved."""


class ProgramDatasetSpec(DatasetSpec):
    """A dataset of a problem of one's own."""

    problem: ProgramProblemSpec
    """What is sampled and solved."""


class TerrainsDatasetSpec(DatasetSpec):
    """A dataset of terrains."""

    problem: TerrainsProblemSpec
    """What is sampled and solved."""


class WalksDatasetSpec(DatasetSpec):
    """A dataset of walks."""

    problem: WalksProblemSpec
    """What is sampled and solved."""


BY_PROBLEM: dict[
    str,
    type[ShelfDatasetSpec]
    | type[ProgramDatasetSpec]
    | type[TerrainsDatasetSpec]
    | type[WalksDatasetSpec],
] = {
    "bookshelf": ShelfDatasetSpec,
    "program": ProgramDatasetSpec,
    "terrains": TerrainsDatasetSpec,
    "mpc": WalksDatasetSpec,
}
