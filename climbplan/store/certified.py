"""Problems with the proofs of their bounds: what `climbplan solve --certificate` writes."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array, IntArray
from climbplan.certificates.certificate import Certificate
from climbplan.program.instance import Instance
from climbplan.solvers.result import Status
from climbplan.store.root_attributes import Origin


@dataclass(frozen=True)
class CertifiedRow:
    """The data of one problem, its answer and what is claimed of it."""

    parameters: Array  # (p,) of the statement
    instance: Instance
    certificate: Certificate
    status: Status
    x: Array | None  # (n,) the answer
    assignment: IntArray | None  # (C,) chosen alternative of each choice


@dataclass(frozen=True, kw_only=True)
class CertifiedRows(Origin):
    """The problems of a spec, in the order of its rows."""

    problem: str
    gap: float  # relative: what `optimal` means
    tolerance: float  # largest violation of an answer
    rows: tuple[CertifiedRow, ...]
