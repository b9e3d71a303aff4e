"""Proofs of leaves that the checker has accepted, and certificates made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import sparse

from climbplan.arrays import IntArray
from climbplan.certificates.box import CertificateBox
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import Checker
from climbplan.certificates.lagrangian import build_lagrangian
from climbplan.certificates.rows import CertificateRows
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer.multiplier_map import Multipliers


class LeafProof(NamedTuple):
    """A bound of a leaf, and the multipliers that prove it."""

    bound: float
    multipliers: Multipliers


class LeafProofs:
    """Evaluates multipliers of leaves by the certificate checker."""

    def __init__(self, instance: Instance) -> None:
        """Raises UsageError for statements beyond what certificates support."""
        self.instance, self.checker = instance, Checker(instance)
        self._choices = _locate_choices(instance, self.checker.rows)

    def check(
        self, rows: CertificateRows, box: CertificateBox, multipliers: Multipliers
    ) -> LeafProof:
        """Check what multipliers prove of a leaf; `rows` includes the planes of its box."""
        balanced = self._balance_choices(rows, box, multipliers)
        return LeafProof(self.checker.evaluate_leaf(box, *balanced)[0], balanced)

    def zero_multipliers(self, box: CertificateBox) -> Multipliers:
        """Return zero multipliers, which prove what the box alone implies."""
        n = self.instance.size
        with np.errstate(invalid="ignore"):
            midpoint = 0.5 * (box.lower[:n] + box.upper[:n])
        coordinates = sum(balls.f.size for balls in self.instance.balls)
        rows = len(self.checker.rows.lower) + 4 * len(self.checker.rows.w)
        return Multipliers(
            np.where(np.isfinite(midpoint), midpoint, 0.0), np.zeros(rows), np.zeros(coordinates)
        )

    def _balance_choices(
        self, rows: CertificateRows, box: CertificateBox, multipliers: Multipliers
    ) -> Multipliers:
        """Return multipliers for which the best alternative of each choice costs nothing."""
        if not self._choices:
            return multipliers
        slope = build_lagrangian(self.instance, rows, box, *multipliers).slope
        y = multipliers.rows.copy()
        for row, binaries in self._choices:
            allowed = binaries[box.upper[binaries] == 1.0]
            y[row] += slope[allowed].min() if len(allowed) else 0.0
        return multipliers._replace(rows=y) if np.isfinite(y).all() else multipliers


@dataclass
class CertificateWriter:
    """The nodes of a certificate in preorder, as far as they are written."""

    split: list[int] = field(default_factory=list)
    split_value: list[float] = field(default_factory=list)
    leaves: list[LeafProof] = field(default_factory=list)

    def append_split(self, variable: int, value: float) -> None:
        """Append a node with two children, which have to follow."""
        self.split.append(variable)
        self.split_value.append(value)

    def append_leaf(self, proved: LeafProof) -> None:
        """Append a leaf."""
        self.append_split(-1, 0.0)
        self.leaves.append(proved)

    def build(self, instance: Instance) -> Certificate:
        """Build the certificate; points are stored for variables with curved cost only."""
        multipliers = [leaf.multipliers for leaf in self.leaves]
        n, curved = instance.size, np.diff(instance.P.indptr) > 0
        points = [
            np.zeros(n)
            if leaf_multipliers.point is None
            else np.where(curved, leaf_multipliers.point, 0.0)
            for leaf_multipliers in multipliers
        ]
        return Certificate(
            split=np.array(self.split, np.int64),
            at=np.array(self.split_value),
            point=np.array(points),
            multiplier=sparse.csr_matrix(
                sparse.vstack(
                    [sparse.csr_matrix(leaf_multipliers.rows) for leaf_multipliers in multipliers]
                )
            ),
            ball=np.array([leaf_multipliers.ball for leaf_multipliers in multipliers]),
            empty=np.array([leaf_multipliers.point is None for leaf_multipliers in multipliers]),
            bound=min(leaf.bound for leaf in self.leaves),
        )


def _locate_choices(instance: Instance, rows: CertificateRows) -> list[tuple[int, IntArray]]:
    """Return the equation of each choice, and its binaries in v."""
    choices, z = [], instance.size
    row = len(rows.lower) - sum(balls.f.size for balls in instance.balls) - len(instance.choices)
    for k, choice in enumerate(instance.choices):
        choices.append((row + k, np.arange(z, z + len(choice.alternatives))))
        z += len(choice.alternatives)
    return choices
