"""The published pieces of the bookshelf's bilinear terms (facts of the code of arXiv 2110.00666).

Angles in eighths of the half turn, components of normals in eighths of [-1, 1], corner coordinates
in quarters of the frame: with log2 encoding 3 binaries an angle, 6 a line, 4 a corner.
"""

from __future__ import annotations

import math

import numpy as np

from climbplan.program import Program
from climbplan.reformulations.grids import Partition, each, pieces, together, uniform

ANGLES = 8
NORMALS = 8
CORNERS = 4
OVERLAP = 0.05  # of cosines, sines and normals
END = 1.5  # [mm] beyond the frame


def published_partitions(program: Program) -> tuple[Partition, ...]:
    """Partitions of a bookshelf program, over the frame that its centres may be in."""
    variables = program.variables
    center = variables["center"]
    cos, sin = variables["cos"], variables["sin"]
    found = [_arc(cos.start + k, sin.start + k) for k in range(math.prod(cos.shape))]
    found += each(variables["normal"], uniform(-1.0, 1.0, NORMALS, OVERLAP))
    vertex = variables["vertex"]
    index = np.arange(vertex.start, vertex.stop).reshape(vertex.shape)
    for axis, (low, high) in enumerate(zip(center.lower[0], center.upper[0], strict=True)):
        ends = pieces(np.linspace(low, high, CORNERS + 1))
        ends[0, 0] -= END
        ends[-1, 1] += END
        found += each(index[..., axis].ravel().tolist(), ends)
    return tuple(found)


def _arc(cos: int, sin: int) -> Partition:
    """Boxes around pieces of the half circle, one set of binaries for cosine and sine."""
    knots = np.linspace(-math.pi / 2, math.pi / 2, ANGLES + 1)
    c, s = np.cos(knots), np.sin(knots)
    low = np.column_stack([np.minimum(c[:-1], c[1:]), s[:-1]]) - OVERLAP
    high = np.column_stack([np.maximum(c[:-1], c[1:]), s[1:]]) + OVERLAP
    return together([cos, sin], low, high, covering=True)
