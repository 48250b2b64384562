"""The tool that runs a user's first hour sees what goes wrong, and takes the README's commands as they stand."""

from pathlib import Path

import first_hour
import pytest
from first_hour import Home, Typed, faults, readme_commands, transcript


def test_the_commands_are_the_lines_of_the_readme() -> None:
    commands = readme_commands()
    assert commands[:2] == ["make demo", "make test"]
    assert "viewshed demo --out demo" in commands
    assert any(command.startswith("viewshed monitor explain demo/relayed.npz") for command in commands)
    assert not any("#" in command for command in commands)


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


def test_a_command_sees_nothing_of_the_caller_and_its_silence_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_OF_MINE", "1")
    home = Home(tmp_path)
    done = home.type("echo begun; sleep 0.4; env; ls ~; exit 3", tmp_path)
    assert done.code == 3
    assert "SECRET_OF_MINE" not in done.output
    assert "HOME=~" in done.output
    assert 0.3 < done.silent_s <= done.seconds < 10
    assert "$ echo begun; sleep 0.4; env; ls ~; exit 3\nbegun\n" in transcript(home)
    assert first_hour.SILENT_S == 3.0
