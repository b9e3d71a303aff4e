"""Which methods compete, with which settings and on how many of the scenes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.scene.shelf_scene import Shelf
from climbplan.bookshelf.schema.model import Meaning, ShelfSolverSpec
from climbplan.errors import UsageError

Effort = Literal["all", "some", "few"]
MEANINGS: tuple[Meaning, ...] = ("contact", "published")


@dataclass(frozen=True)
class Contender:
    """One method with its settings."""

    key: str  # as `--methods` takes it
    label: str
    options: dict[str, Any]  # of `ShelfSolverSpec`
    effort: Effort = "all"  # on how many scenes it runs, by its speed
    learns: bool = False  # needs a library
    meanings: tuple[Meaning, ...] = field(default=MEANINGS)

    def setting(
        self, shelf: Shelf, meaning: Meaning, library: Path | None, seconds: float
    ) -> MethodSetting:
        """What the method is made of; seconds: limit of one scene for the slow ones."""
        options = dict(self.options)
        if self.learns:
            # One library for both meanings: the placements of `contact`.
            options["library"] = {"file": str(library), "allow_other_shelves": meaning != "contact"}
        if self.effort == "few":
            options["time_limit"] = seconds
        spec = ShelfSolverSpec.model_validate(options)
        return MethodSetting(shelf, meaning, spec, Path())


CONTENDERS = (
    Contender("exact", "exact", {"method": "exact"}, meanings=("contact",)),
    Contender(
        "convex-qp",
        "pinned, 10 candidates, one QP each (OSQP)",
        {"method": "pinned", "max_candidates": 10, "max_refinements": 0, "solver": "osqp"},
        effort="some",
        learns=True,
    ),
    Contender(
        "convex-10",
        "pinned, 10 candidates, local SQP",
        {"method": "pinned", "max_candidates": 10},
        learns=True,
    ),
    Contender(
        "convex-50",
        "pinned, 50 candidates, local SQP",
        {"method": "pinned", "max_candidates": 50},
        learns=True,
    ),
    Contender(
        "knn",
        "knn, 10 candidates, then exact",
        {"method": "knn", "max_candidates": 10},
        learns=True,
        meanings=("contact",),  # `exact` answers in this meaning only
    ),
    Contender(
        "mpcc-knn",
        "mpcc, 3 neighbours",
        {"method": "mpcc", "start": "knn", "max_candidates": 3},
        learns=True,
    ),
    Contender("mpcc-manual", "mpcc, manual start", {"method": "mpcc", "start": "manual"}),
    Contender("mpcc-zero", "mpcc, zero start", {"method": "mpcc", "start": "zero"}, effort="some"),
    Contender("admm", "admm, manual start", {"method": "admm"}, effort="few"),
    Contender(
        "mccormick", "mccormick, 130 binaries (HiGHS)", {"method": "mccormick"}, effort="few"
    ),
    Contender("minlp-scip", "minlp (SCIP)", {"method": "minlp-scip"}, effort="few"),
    Contender("minlp-bonmin", "minlp (Bonmin)", {"method": "minlp-bonmin"}, effort="few"),
)


def chosen(names: str | None) -> tuple[Contender, ...]:
    """Contenders by comma-separated keys, all of them without any.

    Raises:
        UsageError: a key that is not known.
    """
    if names is None:
        return CONTENDERS
    known = {contender.key: contender for contender in CONTENDERS}
    keys = [key.strip() for key in names.split(",") if key.strip()]
    if unknown := [key for key in keys if key not in known]:
        raise UsageError(f"no method {unknown[0]!r} to compare, known are {', '.join(known)}")
    return tuple(contender for contender in CONTENDERS if contender.key in keys)
