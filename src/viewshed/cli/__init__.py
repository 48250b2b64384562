"""The command line: ``viewshed estimate | info | compare | export | demo | evaluate``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from viewshed import __version__
from viewshed.cli.compare import compare
from viewshed.cli.demo import demo
from viewshed.cli.estimate import estimate
from viewshed.cli.evaluate import evaluate_app
from viewshed.cli.export import export
from viewshed.cli.info import info

BAD_INPUT = 2
INTERRUPTED = 130

app = typer.Typer(
    name="viewshed", no_args_is_help=True, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False,
    help="What can this LiDAR see, how sure are we, and is someone lying about it?",
)  # fmt: skip
for _command in (estimate, info, compare, export, demo):
    app.command()(_command)
app.add_typer(evaluate_app, name="evaluate")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"viewshed {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """What can this LiDAR see, how sure are we, and is someone lying about it?"""


def main() -> None:
    """Run a command; bad input is one line on standard error and exit code 2."""
    try:
        app()
    except (ValueError, OSError, ImportError, MemoryError) as error:
        typer.echo(f"viewshed: {one_line(error)}", err=True)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def one_line(error: BaseException) -> str:
    r"""Return an error's message without line breaks.

    >>> one_line(ValueError("a\nb"))
    'a b'
    """
    return " ".join(str(error).split()) or type(error).__name__
