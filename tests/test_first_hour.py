"""The tool that runs a user's first hour sees what goes wrong, and takes the README's commands as they stand."""

from pathlib import Path

import first_hour
import pytest
from first_hour import Home, Typed, faults, instead, readme_commands, transcript


def test_the_commands_are_the_lines_of_the_readme() -> None:
    commands = readme_commands()
    assert commands[:2] == ["make demo", "source .venv/bin/activate"]
    assert "viewshed demo --out demo" in commands
    assert any(command.startswith("viewshed monitor check demo/replay.mcap") for command in commands)
    assert not any("#" in command for command in commands)
    # A command of the laboratory comes after the laboratory is installed.
    assert commands.index("pip install packages/viewshed-lab") < next(
        k for k, command in enumerate(commands) if command.startswith("viewshed record sim")
    )


@pytest.mark.parametrize(
    ("output", "code", "found"),
    [
        ("all is well", 0, []),
        ("no such file", 2, ["x: exit code 2"]),
        ("Traceback (most recent call last):\n  …", 0, ["x: a traceback"]),
        ("seen → there.png", 0, []),
        ("seen → gone.png", 0, ["x: gone.png is not there"]),
    ],
)
def test_what_goes_wrong_is_told(output: str, code: int, found: list[str], tmp_path: Path) -> None:
    (tmp_path / "there.png").touch()
    assert faults(Typed("x", output, code, 1.0, 1.0), tmp_path) == found


def test_one_shell_sees_nothing_of_the_caller_and_its_silence_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_OF_MINE", "1")
    (tmp_path / "activate").write_text("export NAMED=ours\n")
    with Home(tmp_path) as home:
        home.type("source activate  # as an environment is entered")
        done = home.type("echo begun; sleep 0.4; env; ls ~; (exit 3)")
        assert home.type("cat").output == ""  # nobody types more
    assert done.code == 3
    assert "SECRET_OF_MINE" not in done.output
    assert "NAMED=ours" in done.output
    assert "HOME=~" in done.output
    assert 0.3 < done.silent_s <= done.seconds < 10
    assert "$ echo begun; sleep 0.4; env; ls ~; (exit 3)\nbegun\n" in transcript(home)
    assert first_hour.SILENT_S == 3.0


@pytest.mark.parametrize(
    ("command", "given", "typed"),
    [
        ("make demo", None, ["make demo PYTHON=python3"]),
        ("source .venv/bin/activate", ["a", "b"], ["source .venv/bin/activate"]),
        ("pip install packages/viewshed-lab", ["a", "b"], [".venv/bin/pip install --disable-pip-version-check b"]),
        ("viewshed demo", ["a", "b"], ["viewshed demo"]),
    ],
)
def test_wheels_take_the_place_of_the_checkout(command: str, given: list[str] | None, typed: list[str]) -> None:
    assert instead(command, given, "python3") == typed
