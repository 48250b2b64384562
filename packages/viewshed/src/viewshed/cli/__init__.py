"""The command line: ``viewshed estimate``, ``view``, ``fuse`` and more, one file each; other packages add commands."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, cast

import typer

from viewshed import __version__
from viewshed._extras import LABORATORY, load, needed_for, plugin, plugins
from viewshed.cli._options import SectionedCommand, with_groups
from viewshed.cli._status import status_line
from viewshed.cli._terminal import BAD_INPUTS, complain, heeding_interrupts, note, one_line, was_interrupted
from viewshed.cli.compare import compare
from viewshed.cli.demo import demo
from viewshed.cli.estimate import estimate
from viewshed.cli.export import export
from viewshed.cli.fuse import fuse
from viewshed.cli.info import info
from viewshed.cli.monitor import monitor_app
from viewshed.cli.record import record
from viewshed.cli.replay import replay
from viewshed.cli.view import view

BAD_INPUT = 2
INTERRUPTED = 130
_Refused: type[Exception] = typer.BadParameter.__mro__[2]  # ClickException: typer has no public name for it

_COMMANDS = (estimate, info, compare, view, replay, record, fuse, export, demo)
LABORATORY_COMMANDS = (
    "simulate", "label", "attack", "corrupt", "train", "crossval", "quantize", "evaluate", "dataset", "study"
)  # fmt: skip
"""Commands of the package viewshed-lab, in the order of the help."""


@cache
def application() -> typer.Typer:
    """Return the Typer application: the commands of this package, and those of installed packages by entry points.

    Built lazily, because a module of such a package may import this one.
    """
    app = typer.Typer(name="viewshed", add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    points = plugins("commands")
    missing = [name for name in LABORATORY_COMMANDS if name not in points]
    more = f"{', '.join(missing)}: pip install {LABORATORY}" if missing else None
    app.callback(invoke_without_command=True, epilog=more)(_root)
    for command in _COMMANDS:
        app.command(cls=SectionedCommand)(with_groups(command))
    app.add_typer(monitor_app, name="monitor")
    for name in dict.fromkeys([*LABORATORY_COMMANDS, *sorted(points)]):
        loaded: Any = None
        problem: ImportError | None = None
        try:
            if name in points:
                loaded = load(points[name], callable, "a function or a typer.Typer")
        except ImportError as error:
            problem = error
        if loaded is None:
            words = {"ignore_unknown_options": True, "allow_extra_args": True}
            app.command(name, hidden=True, add_help_option=False, context_settings=words)(_missing(name, problem))
        elif isinstance(loaded, typer.Typer):
            app.add_typer(loaded, name=name)
        else:
            app.command(name, cls=SectionedCommand)(with_groups(loaded))
    return app


def _missing(name: str, problem: ImportError | None) -> Callable[[], None]:
    """Return a command that names the package that provides it, or raises why it cannot be loaded."""

    def command() -> None:
        if problem is not None:
            raise problem
        plugin("commands", name, f"viewshed {name}")

    return command


def _version(is_given: bool) -> None:
    if is_given:
        typer.echo(f"viewshed {__version__}")
        raise typer.Exit


def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """What can this LiDAR see, how sure are we, and is someone lying about it?

    Start with: viewshed demo
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit; bad input is one line on standard error and exit code 2, Ctrl-C is exit code 130.

    Args:
        arguments: the command and its options; None for those of the process.
    """
    words = sys.argv[1:] if arguments is None else arguments
    with heeding_interrupts():
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _warn
                with status_line(" ".join(words[:1])), needed_for(" ".join(["viewshed", *words[:1]])):
                    sys.exit(application()(words, standalone_mode=False))
        except _Refused as error:
            _refuse(cast(typer.BadParameter, error).format_message())
        except (KeyboardInterrupt, typer.Abort):
            sys.exit(INTERRUPTED)
        except (*BAD_INPUTS, SystemError) as error:
            if was_interrupted():  # compiled code turned the interrupt into this error
                sys.exit(INTERRUPTED)
            if isinstance(error, SystemError):
                raise
            _refuse(one_line(error))


def _warn(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    """Print a warning in one line, without the source location that Python would add."""
    line = " ".join(str(message).split())
    if category.__name__ == "Assumption":  # of viewshed.io, which is imported only where files are read
        note(line)
    else:
        complain(f"warning: {line}")


def _refuse(message: str) -> None:
    complain(" ".join(message.split()))
    sys.exit(BAD_INPUT)
