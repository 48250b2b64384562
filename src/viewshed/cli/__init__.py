"""The command line: ``viewshed estimate``, ``simulate``, ``attack`` and more; each is one file."""

from __future__ import annotations

import sys
import warnings
from typing import Annotated, TextIO, cast

import typer

from viewshed import __version__
from viewshed._extras import needed_for
from viewshed.cli._options import with_groups
from viewshed.cli._status import status_line
from viewshed.cli._terminal import BAD_INPUTS, complain, one_line
from viewshed.cli.attack import attack, corrupt
from viewshed.cli.compare import compare
from viewshed.cli.demo import demo
from viewshed.cli.estimate import estimate
from viewshed.cli.evaluate import evaluate_app
from viewshed.cli.export import export
from viewshed.cli.fuse import fuse
from viewshed.cli.info import info
from viewshed.cli.label import label
from viewshed.cli.monitor import monitor_app
from viewshed.cli.quantize import quantize
from viewshed.cli.record import record
from viewshed.cli.replay import replay
from viewshed.cli.simulate import dataset_app, simulate
from viewshed.cli.study import report_app, reproduce, study_app
from viewshed.cli.train import crossval, train
from viewshed.cli.view import view

BAD_INPUT = 2
INTERRUPTED = 130
_Refused: type[Exception] = typer.BadParameter.__mro__[2]  # ClickException: typer has no public name for it
app = typer.Typer(name="viewshed", add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)

_COMMANDS = (
    estimate, info, compare, view, replay, record, fuse, export, demo, simulate, label, attack, corrupt, train,
    crossval, quantize,
)  # fmt: skip

for _command in _COMMANDS:
    app.command()(with_groups(_command))
app.command(hidden=True)(reproduce)
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(dataset_app, name="dataset")
app.add_typer(study_app, name="study")
app.add_typer(report_app, name="report", hidden=True)
app.add_typer(monitor_app, name="monitor")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"viewshed {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """What can this LiDAR see, how sure are we, and is someone lying about it?

    Start with: viewshed demo
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit; bad input is one line on standard error and exit code 2, Ctrl-C is exit code 130.

    Args:
        arguments: the command and its options; None takes those of the process.
    """
    words = sys.argv[1:] if arguments is None else arguments
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            with status_line(" ".join(words[:1])), needed_for(" ".join(["viewshed", *words[:1]])):
                sys.exit(app([_current_option(word) for word in words], standalone_mode=False))
    except _Refused as error:
        _refuse(cast(typer.BadParameter, error).format_message())
    except BAD_INPUTS as error:
        _refuse(one_line(error))
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(INTERRUPTED)
    except SystemError as error:  # how an interrupt leaves compiled code
        if not _from_interrupt(error):
            raise
        sys.exit(INTERRUPTED)


_FORMER_OPTIONS = {
    "--past": "--history",
    "--wary": "--require-confirmation",
    "--sure": "--abstain-below",
    "--told": "--known",
}
"""Options of version 0.3, taken as well for one version."""


def _current_option(word: str) -> str:
    """Return a word of the command line with the current name of an option.

    >>> _current_option("--past=5"), _current_option("sweep.bin")
    ('--history=5', 'sweep.bin')
    """
    option, equals, value = word.partition("=")
    return _FORMER_OPTIONS.get(option, option) + equals + value


def _from_interrupt(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Say a warning as other complaints are said, without the place in the source that Python would add."""
    complain(f"warning: {' '.join(str(message).split())}")


def _refuse(message: str) -> None:
    complain(" ".join(message.split()))
    sys.exit(BAD_INPUT)
