"""Every command and option says in plain words what it does."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from typer.main import get_command

from viewshed.cli import application

ODD = ("in the box", "else as", "in bytes", "told", "asked for", "of sim:", "less it", "so many", "of a network:")
"""Words that a reader of the first hour stumbled over, and the like."""


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    yield name, command
    for word, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{name} {word}")


COMMANDS = dict(_commands(get_command(application()), "viewshed"))


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_plain(name: str) -> None:
    command = COMMANDS[name]
    texts = {"": command.help or ""} | {one.name: getattr(one, "help", None) or "" for one in command.params}
    for option, text in texts.items():
        if option in ("help", "version", "install_completion", "show_completion"):
            continue
        assert re.match(r"[\w'(]", text), f"{name} {option}: no help"
        assert [word for word in ODD if word in text.lower()] == [], f"{name} {option}: {text}"


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "viewshed"])
def test_the_list_of_commands_is_not_cut_off_on_a_terminal_of_80_columns(name: str) -> None:
    assert not COMMANDS[name].get_short_help_str(limit=65).endswith("..."), name
