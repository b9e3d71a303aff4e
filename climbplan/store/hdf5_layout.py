"""How one dataset of a file looks, as data that writing and reading share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["float", "int", "bool", "text"]


@dataclass(frozen=True)
class DatasetLayout:
    """One dataset: its shape in symbols ("K", "N") and numbers, its units and its frame."""

    shape: tuple[str | int, ...]
    units: str = ""
    frame: str = ""
    kind: Kind = "float"
    may_be_infinite: bool = False
    may_be_nan: bool = False  # and infinite: entries that stand for nothing
