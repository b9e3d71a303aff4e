"""Dataset spec (`kind: dataset`): many sampled problems of one kind, each solved (7.2, 5.2.2)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from climbplan.bookshelf.schema.dataset import BookshelfProblemSpec
from climbplan.climb.schema.terrains_dataset import TerrainsProblemSpec
from climbplan.datasets.schema.motions import MotionsProblemSpec
from climbplan.schema.base import Count, Number, SpecModel, quantity
from climbplan.schema.program.model import ProgramSolverSpec
from climbplan.walking.schema.dataset import WalksProblemSpec


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


ProblemSpec = Annotated[
    BookshelfProblemSpec
    | MotionsProblemSpec
    | ProgramProblemSpec
    | TerrainsProblemSpec
    | WalksProblemSpec,
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
    shard_size: Count = quantity(
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


class MotionsDatasetSpec(DatasetSpec):
    """A dataset of motions."""

    problem: MotionsProblemSpec
    """What is sampled and solved."""


AnyDatasetSpec = (
    ShelfDatasetSpec
    | ProgramDatasetSpec
    | TerrainsDatasetSpec
    | WalksDatasetSpec
    | MotionsDatasetSpec
)
AnyDatasetModel = (
    type[ShelfDatasetSpec]
    | type[ProgramDatasetSpec]
    | type[TerrainsDatasetSpec]
    | type[WalksDatasetSpec]
    | type[MotionsDatasetSpec]
)
BY_PROBLEM: dict[str, AnyDatasetModel] = {
    "bookshelf": ShelfDatasetSpec,
    "program": ProgramDatasetSpec,
    "terrains": TerrainsDatasetSpec,
    "mpc": WalksDatasetSpec,
    "motions": MotionsDatasetSpec,
}
