"""Whether a certificate proves what it says of an instance.

Nothing of the solver that made it is used: the box is found again, leaves are compared with all
integers that it leaves, and multipliers are worth what the instance's own numbers make of them. All
arithmetic is rounded so that errors make proofs weaker. Bounds hold for every point that violates
no row and no ball by more than `TOLERANCE`, bounds and integers exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.certificates.box import Box, implied_box
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.cover import Leaves, Part, uncovered
from climbplan.certificates.lagrangian import proved
from climbplan.certificates.rows import StatedRows, stated_rows
from climbplan.program.instance import Instance

TOLERANCE = 1e-10


@dataclass(frozen=True)
class Verdict:
    """What is proved, and what is wrong with the certificate if it proves nothing."""

    bound: float  # no feasible point costs less: infinite if there is none, -infinite if not proved
    margin: float  # of infeasibility: all rows may be let out by so much and nothing is feasible
    faults: tuple[str, ...]
    weakest: int  # leaf that decides the bound, -1 without leaves

    @property
    def infeasible(self) -> bool:
        """Whether it is proved that nothing is feasible."""
        return self.bound == np.inf


def check(instance: Instance, certificate: Certificate) -> Verdict:
    """Everything that a certificate proves of an instance.

    Raises UsageError for statements beyond what certificates hold.
    """
    rows = stated_rows(instance)
    faults = tuple(_malformed(instance, rows, certificate))
    if faults:
        return _nothing(*faults)
    box = implied_box(instance, rows, certificate.lower, certificate.upper, TOLERANCE)
    if box.empty:
        return Verdict(np.inf, TOLERANCE, (), -1)
    outside = np.flatnonzero(~box.within(certificate.lower, certificate.upper))
    if len(outside):
        j = outside[0]
        return _nothing(
            f"box: bounds imply {box.lower[j]:.17g} to {box.upper[j]:.17g} for variable {j}, not "
            f"{certificate.lower[j]:.17g} to {certificate.upper[j]:.17g}"
        )
    fault = _gap_in_cover(instance, rows, certificate, box)
    if fault:
        # The box came to lie within the one given; further sweeps may exclude what no leaf has
        nowhere = np.full(instance.size, np.inf)
        box = implied_box(instance, rows, nowhere, -nowhere, TOLERANCE)
        if box.empty:
            return Verdict(np.inf, TOLERANCE, (), -1)
        fault = _gap_in_cover(instance, rows, certificate, box)
    if fault:
        return _nothing(fault)
    leaves = proved(instance, rows, certificate, TOLERANCE)
    weakest = int(np.argmin(leaves.bound))
    bound = float(leaves.bound[weakest])
    margin = float(leaves.margin.min()) if bound == np.inf else 0.0
    return Verdict(bound, margin, (), weakest)


def _nothing(*faults: str) -> Verdict:
    return Verdict(-np.inf, 0.0, faults, -1)


def _malformed(instance: Instance, rows: StatedRows, c: Certificate) -> list[str]:
    """Arrays that do not fit the instance, or that are not numbers."""
    n, count = instance.size, len(c.low)
    integers = int(instance.integer.sum())
    coordinates = sum(balls.f.size for balls in instance.balls)
    shapes = {
        "lower": (n,),
        "upper": (n,),
        "low": (count, integers),
        "high": (count, integers),
        "allowed": (count, len(rows.choice)),
        "point": (count, n),
        "multiplier": (count, rows.count),
        "ball": (count, coordinates),
        "empty": (count,),
    }
    out = []
    for name, shape in shapes.items():
        array = getattr(c, name)
        numbers = array.data if name == "multiplier" else array
        if array.shape != shape:
            out.append(f"{name}: shape {shape} expected, got {array.shape}")
        elif name in ("point", "multiplier", "ball") and not np.isfinite(numbers).all():
            out.append(f"{name}: finite numbers expected")
        elif name in ("lower", "upper") and np.isnan(numbers).any():
            out.append(f"{name}: numbers expected")
    return out


def _gap_in_cover(instance: Instance, rows: StatedRows, c: Certificate, box: Box) -> str:
    """Integers that no leaf has, in words; nothing if there are none."""
    integers = np.flatnonzero(instance.integer)
    if not (np.isfinite(box.lower[integers]) & np.isfinite(box.upper[integers])).all():
        return "cover: an integer has no bound"
    low = box.lower[integers].astype(np.int64)
    target = Part(low, box.upper[integers].astype(np.int64), box.allowed)
    leaves = Leaves(c.low, c.high, c.allowed, rows.choice)
    try:
        left = uncovered(target, leaves)
    except RuntimeError as error:
        return f"cover: {error}"
    if left is None:
        return ""
    free = integers[left.low < left.high]
    fixed = ", ".join(
        f"x{j} = {v}" for j, v in zip(integers, left.low, strict=True) if j not in free
    )
    return f"cover: no leaf has {fixed or 'the integers'}" + (
        f" and alternatives {np.flatnonzero(left.allowed).tolist()}" if len(rows.choice) else ""
    )
