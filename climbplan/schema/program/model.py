"""Spec of a stated program (`kind: program`): parameters and method for a problem of one's own.

The statement itself is Python and is named on the command line only (`--problem`): reading a spec
never imports code.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, WithJsonSchema, model_validator

from climbplan.schema.base import Count, Fault, Number, SpecModel, quantity, refuse
from climbplan.schema.learning.model_file import ModelFileSpec

Values = float | list[Any]  # numbers, nested as the parameter's shape is
_MOST_DEEP = 4

_NUMBERS = {
    "type": "object",
    "additionalProperties": {"anyOf": [{"type": "number"}, {"type": "array"}]},
}
_THETA = WithJsonSchema({"anyOf": [_NUMBERS, {"type": "array", "items": _NUMBERS}]})


def _find_theta_faults(value: Any) -> Iterator[Fault]:
    several = isinstance(value, list)
    entries = value if several else [value]
    if several and not entries:
        yield Fault("theta", "expected at least one mapping from parameter to numbers")
    for k, entry in enumerate(entries):
        place = f"theta.{k}" if several else "theta"
        if not isinstance(entry, dict) or not all(isinstance(key, str) for key in entry):
            yield Fault(place, "expected a mapping from parameter to numbers")
            continue
        for name, numbers in entry.items():
            if not _is_numeric(numbers, 0):
                yield Fault(f"{place}.{name}", "expected a number or (nested) lists of numbers")


def _is_numeric(value: Any, depth: int) -> bool:
    if isinstance(value, list):
        return depth < _MOST_DEEP and all(_is_numeric(v, depth + 1) for v in value)
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


class SampleSpec(SpecModel):
    """Parameters drawn by the problem's own sampler."""

    count: Count = quantity("", "how many to draw, with the spec's seed", gt=0, le=1_000_000)


class EnvelopeSpec(SpecModel):
    """How `mccormick` and `admm` make a program mixed-integer convex."""

    pieces: Count = quantity(
        "", "pieces of each McCormick grid that the problem gives no partition for", default=6, ge=1
    )
    rounds: Count = quantity(
        "",
        "rounds of `mccormick`: each doubles the pieces on what the incumbent leaves",
        default=2,
        ge=1,
        le=20,
    )
    disjunctions: Literal["big-m", "hull"] = Field(
        default="big-m", description="`big-m` from bounds, or the `hull` with its copies"
    )
    encoding: Literal["unary", "log2"] = Field(
        default="unary", description="one binary a piece, or their logarithm"
    )


ProgramMethod = Literal[
    "auto",
    "branch-and-bound",
    "benders",
    "minlp-scip",
    "minlp-bonmin",
    "mccormick",
    "nlp",
    "mpcc",
    "admm",
    "pinned",
    "knn",
    "forest",
    "boosting",
    "network",
    "reduce",
]
ProgramStart = Literal["zero", "manual", "knn"]


class ProgramSolverSpec(SpecModel):
    """Which method, and when to stop."""

    method: ProgramMethod = Field(
        default="auto",
        description="`auto`: `branch-and-bound` where the statement is convex but for its "
        "integers and up to 50 products, else `mccormick`; `branch-and-bound`: the built-in "
        "compiled tree over integers and in space, with a valid bound; `benders`: integers by "
        "cuts, where all else is a convex quadratic program over rows; `minlp-scip`, "
        "`minlp-bonmin`: the whole statement; `mccormick`: piecewise McCormick envelopes, then "
        "the exact program at its integers; `nlp`: IPOPT where there are no integers; `mpcc`: "
        "complementarity; `admm`: alternating between both; `pinned`: integers from a start or a "
        "library; `knn`: `pinned` from the library, then `fallback`; `forest`, `boosting`, "
        "`network`, `reduce`: the same from a trained model",
    )
    solver: (
        Literal["highs", "scip", "gurobi", "ipopt", "sqp", "clarabel", "daqp", "osqp"] | None
    ) = Field(
        default=None,
        description="of `mccormick`, `admm`, `reduce`: highs (default), scip, gurobi; of the rest: "
        "clarabel (default without products), sqp (default with products), ipopt, daqp, osqp",
    )
    start: ProgramStart | None = Field(
        default=None,
        description="where `mpcc` starts: `zero` (the middle of the bounds), `manual` (the "
        "problem's own guess; default if it states one) or `knn` (neighbours in the library)",
    )
    library: str | None = Field(
        default=None,
        min_length=1,
        description="a plan file or dataset of the same problem, relative to the spec; "
        "relative to where you are if set on the command line",
    )
    model: ModelFileSpec | None = Field(
        default=None,
        description="trained strategy: `auto` and `branch-and-bound` try its integers first and "
        "prove the optimum; `forest`, `boosting`, `network`, `reduce` need it, `knn` takes it in "
        "place of a library, and they try nothing else",
    )
    neighbours: Count | None = quantity(
        "",
        "how many sets of integers to try: if left out 10, 3 for `mpcc`, 20 at the root of the "
        "compiled tree; of `reduce` how many "
        "clusters: 1, and further ones while none gave an answer",
        default=None,
        ge=1,
    )
    fallback: Literal[
        "branch-and-bound", "minlp-scip", "minlp-bonmin", "mccormick", "mpcc", "admm", "none"
    ] = Field(default="minlp-scip", description="of learned methods, where no candidate holds")
    gap: Number = quantity(
        "", "relative gap to prove; costs of at most 1e-6 may count as 0", default=1e-4, ge=0
    )
    tolerance: Number = quantity(
        "", "largest residual of any row, in the row's unit", default=1e-6, gt=0, le=0.1
    )
    time_limit: Number = quantity("s", "time limit of one instance", default=60.0, gt=0)
    envelopes: EnvelopeSpec = EnvelopeSpec()
    """Grids and disjunctions."""

    @model_validator(mode="after")
    def _has_what_it_learns_from(self) -> Self:
        faults: list[Fault] = []
        started = self.method == "mpcc" and self.start == "knn"
        if self.library is None and (started or (self.method == "knn" and self.model is None)):
            message = f"method `{self.method}` takes integers from a library: expected one"
            faults.append(Fault("library", message))
        if self.method in ("forest", "boosting", "network", "reduce") and self.model is None:
            message = f"method `{self.method}` needs a trained model: expected `file: model.h5`"
            faults.append(Fault("model", message))
        refuse(faults)
        return self


class ProgramSpec(SpecModel):
    """A problem stated outside the package, with the parameters to solve it at."""

    kind: Literal["program"] = Field(description="always `program`")
    title: str = Field(default="", description="one line for reports")
    problem: str | None = Field(
        default=None,
        description="the problem that this spec is written for, as `--problem` names it; never "
        "followed, only compared",
    )
    theta: Annotated[Any, _THETA] = Field(
        default=None,
        description="numbers of each parameter of the problem, or a list of such mappings",
    )
    sample: SampleSpec | None = Field(
        default=None, description="parameters drawn by the problem's own sampler instead of `theta`"
    )
    solver: ProgramSolverSpec = ProgramSolverSpec()
    """Method and limits."""
    seed: Count = quantity("", "seed of everything random", default=0, ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        faults: list[Fault] = []
        if self.theta is not None and self.sample is not None:
            faults.append(Fault("", "expected either `theta` or `sample`, got both"))
        if self.theta is not None:
            faults += _find_theta_faults(self.theta)
        refuse(faults)
        return self

    @property
    def thetas(self) -> tuple[dict[str, Values], ...]:
        """The parameters that are written out; one empty mapping if there are none at all."""
        if self.sample is not None:
            return ()
        if self.theta is None:
            return ({},)
        return tuple(self.theta) if isinstance(self.theta, list) else (self.theta,)
