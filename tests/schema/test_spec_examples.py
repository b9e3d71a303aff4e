"""Example specs: found, valid, and complete."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.errors import UsageError
from climbplan.schema.examples import (
    FIRST_EXAMPLE,
    list_example_names,
    read_example,
    read_example_data,
)
from climbplan.schema.kinds import KINDS
from climbplan.schema.loading import load_spec

EXAMPLES = [(kind, name) for kind in KINDS for name in list_example_names(kind)]


@pytest.mark.parametrize(("kind", "name"), EXAMPLES)
def test_examples_are_valid_anywhere(kind: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.yaml"
    path.write_text(read_example(name), encoding="utf-8")
    for data, content in read_example_data(name).items():
        (tmp_path / data).write_bytes(content)
    load_spec(path)


def test_every_kind_has_its_first_example() -> None:
    assert set(FIRST_EXAMPLE) == set(KINDS)
    for kind, name in FIRST_EXAMPLE.items():
        assert name in list_example_names(kind)
        assert "#" in read_example(name)  # commented


def test_unknown_names() -> None:
    assert list_example_names("cooking") == []
    with pytest.raises(UsageError, match="did you mean 'silvia'"):
        read_example("sylvia")
