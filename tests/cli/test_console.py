"""What of the libraries' messages reaches standard error."""

from __future__ import annotations

import logging
import warnings

import pytest

from climbplan.cli.console import Invocation, plain_messages


def test_figures_first_run_is_not_told(capsys: pytest.CaptureFixture[str]) -> None:
    library = logging.getLogger("matplotlib.font_manager")
    with plain_messages(Invocation()):
        library.warning("Matplotlib is building the font cache; this may take a moment.")
        library.error("no font at all")
    assert "building the font cache" not in capsys.readouterr().err
    assert library.isEnabledFor(logging.WARNING)  # as it was before


def test_notes_of_the_log_are_lines_of_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("climbplan.somewhere")
    for session, expected in (
        (Invocation(), "seen\nwarning: careful\n"),
        (Invocation(quiet=True), "warning: careful\n"),
        (Invocation(verbose=True), "seen\ndetail\nwarning: careful\n"),
    ):
        with plain_messages(session):
            log.info("seen", extra={"note": True})
            log.info("detail")
            log.warning("careful")
        assert capsys.readouterr().err == expected


def test_warnings_are_single_lines(capsys: pytest.CaptureFixture[str]) -> None:
    with plain_messages(Invocation()), warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.warn("two of them\n  in the source", stacklevel=1)
    assert capsys.readouterr().err.startswith("warning: two of them")
