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
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from climbplan import __version__
from climbplan.cli.console import (
    Session,
    plain_messages,
    prepare_streams,
    print_answer,
    print_error,
    running,
    silence_standard_output,
    standard_output,
)
from climbplan.cli.data import data
from climbplan.cli.doctor import doctor
from climbplan.cli.environment import prepare_environment, require_sound_environment
from climbplan.cli.export import export
from climbplan.cli.failure import (
    INTERRUPTED,
    PIPE_CLOSED,
    TERMINATED,
    failure_fields,
    fault_of_surroundings,
)
from climbplan.cli.fit_envelopes import fit_envelopes
from climbplan.cli.fit_gripper import fit_gripper
from climbplan.cli.fit_stiffness import fit_stiffness
from climbplan.cli.fit_strategy import fit_strategy
from climbplan.cli.fit_terrain import fit_terrain
from climbplan.cli.gen_data import gen_data
from climbplan.cli.interrupts import Terminated, interrupt_handled
from climbplan.cli.new import new
from climbplan.cli.plan_climb import plan_climb
from climbplan.cli.plan_limms import plan_limms
from climbplan.cli.plan_mpc import plan_mpc
from climbplan.cli.plan_transition import plan_transition
from climbplan.cli.report import report
from climbplan.cli.robot import robot
from climbplan.cli.schema import schema
from climbplan.cli.simulate import simulate
from climbplan.cli.solve import solve
from climbplan.cli.solve_bookshelf import solve_bookshelf
from climbplan.cli.supervision import answer_is_printed, end_is_told, supervised
from climbplan.cli.validate import validate
from climbplan.cli.verify import verify
from climbplan.cli.view import view
from climbplan.errors import ClimbplanError, ExitCode

prepare_environment()  # before NumPy is loaded


# As `--help` shows them
GROUPS: dict[str, tuple[Any, ...]] = {
    "Plan": (plan_climb, plan_transition, plan_mpc, plan_limms, solve_bookshelf, solve),
    "Learn": (
        gen_data,
        data,
        fit_strategy,
        fit_envelopes,
        fit_stiffness,
        fit_gripper,
        fit_terrain,
    ),
    "Check": (verify, simulate),
    "Look and take away": (report, view, export),
    "Write and look up": (new, validate, schema, robot, doctor),
}


class _Commands(TyperGroup):
    """Turns the errors that are not bugs into messages and exit codes; commands in groups."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """One table a group, columns at one place."""
        by_group = {
            title: [_called(command) for command in commands] for title, commands in GROUPS.items()
        }
        known = set(self.list_commands(ctx))
        widest = max(len(name) for name in known)
        for title, names in by_group.items():
            rows = []
            for name in names:
                command = self.get_command(ctx, name)
                room = formatter.width - 6 - widest
                if command is not None:
                    rows.append((name.ljust(widest), command.get_short_help_str(room)))
            with formatter.section(title):
                formatter.write_dl(rows)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        session: Session = extra.setdefault("obj", Session())  # absent if Python calls the app
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
        session = ctx.ensure_object(Session)
        try:
            require_sound_environment()
            return super().invoke(ctx)
        except (Exception, KeyboardInterrupt) as error:
            # Libraries make errors of their own of an interrupt; it is one all the same.
            code = _interrupted(error)
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


def _called(command: Any) -> str:
    """What a command is called."""
    return "data" if command is data else str(command.__name__).replace("_", "-")


def _code_of(error: BaseException, session: Session) -> int | None:
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


def _interrupted(error: BaseException) -> int | None:
    """The exit code if a command ended because it was told to, which is said; else None."""
    number = interrupt_handled()
    if number is None and not isinstance(error, KeyboardInterrupt):
        return None
    asked = number == signal.SIGTERM or isinstance(error, Terminated)
    print("terminated" if asked else "interrupted", file=sys.stderr, flush=True)
    end_is_told()
    return TERMINATED if asked else INTERRUPTED


app = typer.Typer(
    cls=_Commands,
    help="Verified plans for robots that move by making and breaking contact.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,  # plain help starts twice as fast, and needs no terminal
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _commands in GROUPS.values():
    for _command in _commands:
        if _command is data:
            app.add_typer(data, name="data")
        else:
            app.command(_called(_command))(_command)


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
    given = list(sys.argv[1:] if arguments is None else arguments)
    session = Session(as_json="--json" in given)
    with running(session):
        code = _invoke(given, session)
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


def _invoke(arguments: Sequence[str], session: Session) -> int:
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
    sys.exit(supervised(_run_and_leave, _answer_for_killed))


def _run_and_leave() -> int:
    """Run the command line; end at once where a solver was left to itself, which may still run."""
    code = int(run())
    interruption = sys.modules.get("climbplan.solvers.interruption")
    if interruption is not None and interruption.has_left_solver():
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code


def _answer_for_killed(code: int, words: str) -> None:
    """What `--json` prints for a process that was killed before it came to it."""
    if "--json" in sys.argv[1:]:
        print_answer(Session(), code, {**failure_fields(None, code, ""), "message": words})
