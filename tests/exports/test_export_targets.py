"""`climbplan export`: where files go, and what is said of plans with few samples."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.cli.app import run


@pytest.mark.parametrize(("out", "written"), [("", "motion.npz"), ("walk", "walk.npz")])
def test_files_have_their_suffix_and_go_into_directories(
    plans: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    out: str,
    written: str,
) -> None:
    arguments = ["export", str(plans["walk"]), "--format", "npz", "-o", str(tmp_path / out)]
    assert run(arguments) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / written)
    assert (tmp_path / written).is_file()


def test_samples_that_are_far_apart_are_pointed_out(
    plans: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["export", str(plans["walk"]), "--format", "npz", "-o", str(tmp_path / "a.npz")]
    assert run(arguments) == 0
    assert "s apart: --rate 100" in capsys.readouterr().err
    arguments[-1] = str(tmp_path / "b.npz")
    assert run([*arguments, "--rate", "100"]) == 0
    assert "s apart" not in capsys.readouterr().err
