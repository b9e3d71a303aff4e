"""`climbplan bench mpc`: offline methods, accuracy of envelopes, bounds, a table each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

from climbplan.mpc.benchmarks.bounds import bound_table
from climbplan.mpc.benchmarks.envelope_accuracy import accuracy_table
from climbplan.mpc.benchmarks.offline import offline_tables

Section = Callable[[int, bool, TextIO], None]  # seed, quick, where to print
SECTIONS: tuple[Section, ...] = (offline_tables, accuracy_table, bound_table)


def run_mpc(seed: int, quick: bool, stream: TextIO) -> None:
    """Print all sections."""
    for section in SECTIONS:
        section(seed, quick, stream)
