"""Model files of other solvers (.mps, .lp, .nl, .qplib), read as stated problems."""

from pathlib import Path

SUFFIXES = (".mps", ".lp", ".nl", ".qplib")


def is_model_file(name: str) -> bool:
    """Return whether a name is that of a model file."""
    return Path(name).suffix.lower() in SUFFIXES
