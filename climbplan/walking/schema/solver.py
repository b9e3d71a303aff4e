"""Methods that plan a walk, their limits, and the library that `online` takes integers from."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, Vector, quantity, refuse


class WalkTubeSpec(SpecModel):
    """Box of attitudes and rates about the walks that `spatial-branch-and-bound` starts from."""

    seeds: Count = quantity(
        "",
        "searches whose answers, and all attitudes between them, are in the box: `seed` and those "
        "after it; `spatial-branch-and-bound` starts from the cheapest",
        default=1,
        ge=1,
        le=100,
    )

    angles_deg: Vector = quantity("deg", "of roll, pitch, yaw either way", default=(2, 4, 2))
    angular_velocity: Vector = quantity(
        "rad/s", "of the angular velocity either way", default=(0.5, 1, 0.5)
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        faults = [
            Fault(key, f"expected three numbers between 0 and {limit}, got {list(values)}")
            for key, values, limit in (
                ("angles_deg", self.angles_deg, 45),
                ("angular_velocity", self.angular_velocity, 20),
            )
            if not (min(values) >= 0 and max(values) <= limit)
        ]
        refuse(faults)
        return self


class WalkSolverSpec(SpecModel):
    """Method and limits."""

    method: Literal["gait-search", "mpcc", "spatial-branch-and-bound", "online"] = Field(
        default="gait-search",
        description="`gait-search`: local search over gaits, each solved by SQP; `mpcc`: contacts "
        "as complementarity, from the guess of a trot; `spatial-branch-and-bound`: mixed-integer "
        "linear relaxation by HiGHS, with a bound; `online`: closed loop with integers from a "
        "library of solved walks",
    )
    time_limit: Number = quantity(
        "s",
        "of the whole run, but for one step of a solver; a cap of the search, which says if it "
        "ended it; of `online`: its library and its walk, what was walked by then is kept",
        150.0,
        gt=0,
    )
    max_qp_solves: Count = quantity(
        "",
        "QPs that the search may solve (some 1 to 4 ms each): with the seed they decide what it "
        "finds, on any machine",
        default=600,
        ge=1,
    )
    gaits: Count | None = quantity(
        "",
        "gaits that the search may try beyond the named ones; as many as its QPs allow if left out",
        default=None,
        ge=1,
    )
    initial_gait: Literal[
        "trot", "slow trot", "walking trot", "jump", "pace", "bound", "walk", "stand"
    ] = Field(
        default="trot",
        description="gait that `mpcc` starts from; of six legs a trot is on tripods, a walk a wave",
    )
    initial_solution: Literal["mpcc", "gait-search"] = Field(
        default="gait-search",
        description="what `spatial-branch-and-bound` starts from: its cost bounds ranges, its "
        "gait is a partial start",
    )
    gap: Number = quantity(
        "",
        "relative gap at which `spatial-branch-and-bound` stops: it looks for motions that are "
        "cheaper by that much",
        default=0.1,
        ge=0,
        lt=1,
    )
    moment_arm_partitions: Count = quantity(
        "",
        "parts of each leg's moment arm that `spatial-branch-and-bound` begins with, a binary "
        "each; doubled once it is solved",
        default=1,
        ge=1,
        le=8,
    )
    height_pieces: Count = quantity(
        "",
        "parts of the body's height in `spatial-branch-and-bound`, as those of moment arms",
        default=1,
        ge=1,
        le=16,
    )
    attitude_box: WalkTubeSpec = WalkTubeSpec()
    """Where attitudes may be in the statement that `spatial-branch-and-bound` bounds."""
    formulation: Literal["pinned", "published"] = Field(
        default="pinned",
        description="what `online` solves: `pinned`: the dynamics linearised about a neighbour, "
        "with DAQP; `published`: McCormick planes in the neighbour's regions, with OSQP, the first "
        "answer taken",
    )
    neighbour_region_fraction: Number = quantity(
        "",
        "share of the regions on either side of the neighbour's that `published` allows too",
        default=0.0,
        ge=0,
        le=1,
    )


class WalkLibrarySpec(SpecModel):
    """Solved walks from random starts, which `online` takes its integers from."""

    size: Count = quantity("", "walks, each solved by `gait-search`", default=12, ge=0, le=100_000)
    gaits: Count = quantity(
        "", "gaits tried for each beyond the named ones", default=5, ge=0, le=10_000
    )
    file: str | None = Field(
        default=None,
        min_length=1,
        description="library.h5 of an earlier run, or dataset.h5 of walks; the first `size` walks "
        "are used; solved anew if left out",
    )
    strategy: Literal["knn", "forest", "boosting", "network", "reduce"] = Field(
        default="knn",
        description="how candidates are chosen: nearest neighbours, or a classifier of gaits "
        "trained on the sections at the start, with the nearest section of each likely gait; "
        "`reduce`: a forest finds the cluster of solutions, whose gaits alone are tried, nearest "
        "first, before those of the next",
    )
