"""The command `climbplan`: its commands, and how every run ends.

Nothing here or in the command files imports a solver, numpy or pydantic until a command runs,
so that `--help` answers at once.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from climbplan import __version__
from climbplan.cli.console import (
    Invocation,
    plain_messages,
    prepare_streams,
    print_answer,
    print_error,
    running,
    silence_standard_output,
    standard_output,
)
from climbplan.cli.environment import prepare_environment, require_sound_environment
from climbplan.cli.failure import (
    INTERRUPTED,
    PIPE_CLOSED,
    TERMINATED,
    failure_fields,
    fault_of_surroundings,
)
from climbplan.cli.interrupts import Terminated, interrupt_handled
from climbplan.cli.supervision import answer_is_printed, end_is_told, run_supervised
from climbplan.errors import ClimbplanError, ExitCode

prepare_environment()  # before NumPy is loaded


# As `--help` shows them; each is in a module of its own, which is imported when it is called
GROUPS = {
    "Plan": (
        "plan-climb",
        "plan-transition",
        "plan-mpc",
        "plan-limms",
        "solve-bookshelf",
        "solve",
        "limits",
    ),
    "Learn": (
        "gen-data",
        "data",
        "fit-strategy",
        "fit-envelopes",
        "fit-stiffness",
        "fit-gripper",
        "fit-terrain",
    ),
    "Check": ("verify", "simulate", "measure"),
    "Look and take away": ("serve", "report", "view", "export"),
    "Write and look up": ("new", "validate", "schema", "robot", "doctor"),
}
_NAMES = tuple(name for names in GROUPS.values() for name in names)
_PLAIN: dict[str, Any] = {
    "rich_markup_mode": None,  # plain help starts twice as fast, and needs no terminal
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


@cache
def _command(name: str) -> Any:
    """Return the command of a name, imported from its module."""
    function = name.replace("-", "_")
    function_or_group = getattr(import_module(f"climbplan.cli.{function}"), function)
    if isinstance(function_or_group, typer.Typer):  # with commands of its own
        return typer.main.get_group(function_or_group)
    single = typer.Typer(add_completion=False, **_PLAIN)
    single.command(name)(function_or_group)
    return typer.main.get_command(single)


class _Commands(TyperGroup):
    """The commands in groups; errors that are not bugs become messages and exit codes."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        named: Any = dict.fromkeys(_NAMES)
        self.commands.update(named)  # for suggestions; `get_command` loads them

    def list_commands(self, ctx: Any) -> list[str]:
        """Return all names in the order of the groups."""
        return list(_NAMES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command and no other."""
        return _command(cmd_name) if cmd_name in _NAMES else super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one table for each group, with aligned columns."""
        widest = max(len(name) for name in _NAMES)
        for title, names in GROUPS.items():
            rows = []
            for name in names:
                command = self.get_command(ctx, name)
                width = formatter.width - 6 - widest
                if command is not None:
                    rows.append((name.ljust(widest), command.get_short_help_str(width)))
            with formatter.section(title):
                formatter.write_dl(rows)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        session: Invocation = extra.setdefault(
            "obj", Invocation()
        )  # absent if Python calls the app
        try:
            return super().make_context(info_name, args, parent, **extra)
        except typer.Exit:
            raise
        except Exception as error:  # before any command is known
            code = _code_of(error, session)
            if code is not None:
                raise typer.Exit(code) from None
            session.error = error
            raise

    def invoke(self, ctx: Any) -> Any:
        session = ctx.ensure_object(Invocation)
        try:
            require_sound_environment()
            return super().invoke(ctx)
        except (Exception, KeyboardInterrupt) as error:
            # Libraries make errors of their own of an interrupt; it is one all the same.
            code = _report_interrupt(error)
            if code is not None:
                raise typer.Exit(code) from None
            if isinstance(error, typer.Exit):
                raise
            session.error = error
            code = _code_of(error, session)
            if code is not None:
                raise typer.Exit(code) from None
            raise
        finally:
            interrupt_handled()


def _code_of(error: BaseException, session: Invocation) -> int | None:
    """Return the exit code of an error that is no bug, once it is printed; None for a bug."""
    stated = fault_of_surroundings(error) or error
    if isinstance(stated, ClimbplanError):
        session.error = stated
        print_error(stated)
        return stated.exit_code
    if isinstance(stated, BrokenPipeError):
        silence_standard_output()
        return PIPE_CLOSED
    return None


def _report_interrupt(error: BaseException) -> int | None:
    """Print that a signal ended the command and return its exit code; None for other errors."""
    number = interrupt_handled()
    if number is None and not isinstance(error, KeyboardInterrupt):
        return None
    is_terminated = number == signal.SIGTERM or isinstance(error, Terminated)
    print("terminated" if is_terminated else "interrupted", file=sys.stderr, flush=True)
    end_is_told()
    return TERMINATED if is_terminated else INTERRUPTED


app = typer.Typer(
    cls=_Commands,
    help="Verified plans for robots that move by making and breaking contact.",
    no_args_is_help=True,
    add_completion=True,
    **_PLAIN,
)


def _print_version(value: bool) -> None:
    if value:
        print(f"climbplan {__version__}")
        raise typer.Exit


@app.callback()
def _global_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Verified plans for robots that move by making and breaking contact."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (by default the process's own) and return its exit code."""
    prepare_streams()
    command_line = list(sys.argv[1:] if arguments is None else arguments)
    session = Invocation(as_json="--json" in command_line)
    with running(session):
        code = _invoke(command_line, session)
    try:
        with standard_output():  # help and version may still be in the buffer
            if session.as_json and code != PIPE_CLOSED:
                failure = failure_fields(session.error, code, session.stage) if code else {}
                print_answer(session, code, failure)
                answer_is_printed()
            return code
    except BrokenPipeError:
        silence_standard_output()
        return PIPE_CLOSED
    except ClimbplanError as error:
        print_error(error)
        return error.exit_code


def _invoke(arguments: Sequence[str], session: Invocation) -> int:
    command = typer.main.get_command(app)
    try:
        with plain_messages(session):
            command.main(args=arguments, prog_name="climbplan", obj=session)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(bool(end.code))
    except Exception as error:  # the one place where a bug becomes an exit code
        if session.verbose:
            traceback.print_exc()
        reason = str(error).partition("\n")[0]
        print(
            f"internal error: {type(error).__name__}: {reason}\n"
            "This is a bug in climbplan; with -v the traceback is printed.",
            file=sys.stderr,
        )
        return ExitCode.INTERNAL
    return ExitCode.OK


def main() -> NoReturn:
    """Entry point of the command line."""
    sys.exit(run_supervised(_run_and_leave, _print_answer_for_killed))


def _run_and_leave() -> int:
    """Run the command line; exit at once if an abandoned solver thread may still run."""
    code = int(run())
    interruption = sys.modules.get("climbplan.solvers.interruption")
    if interruption is not None and interruption.has_abandoned_solver():
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code


def _print_answer_for_killed(code: int, message: str) -> None:
    """Print the JSON object for a process that was killed before it printed one."""
    if "--json" in sys.argv[1:]:
        print_answer(Invocation(), code, {**failure_fields(None, code, ""), "message": message})
