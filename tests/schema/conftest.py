"""A small valid climb spec that tests break in one place at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

SMALL_CLIMB = Path(__file__).with_name("small_climb.yaml")


@pytest.fixture
def small_climb() -> str:
    """Text of a valid climb spec."""
    return SMALL_CLIMB.read_text(encoding="utf-8")
