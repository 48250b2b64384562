"""``viewshed study paper``: bad input is one line, and it goes on where it was."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from viewshed.cli import main
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.store import ResultStore

pytestmark = pytest.mark.slow


def _run(
    capsys: pytest.CaptureFixture[str], *words: str, command: tuple[str, ...] = ("study", "paper")
) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stop:
        main([*command, *words])
    return int(stop.value.code or 0), capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--preset", "huge"], "preset must be one of paper, small, tiny, got 'huge'"),
        (["--only", "data,magic"], "--only must be some of data, models, .*, got 'magic'"),
        (["--protocol", "loose"], "protocol must be among paper, strict, got 'loose'"),
        (["--device", "tpu"], "device must be among cpu, cuda, got 'tpu'"),
        (["--workers", "0"], "workers must be at least 1, got 0"),
        (["--preset", "tiny", "--only", "pairs"], "the other steps need the step data"),
        (["--preset", "tiny", "--only", "pages"], "must hold pairs of the paper protocol, got none; run step pairs"),
    ],
)
def test_bad_input_is_one_line(
    words: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, err = _run(capsys, "--out", str(tmp_path / "study"), *words)
    assert code == 2
    assert err.count("\n") == 1
    assert re.search(complaint, err)


def test_a_folder_of_another_plan_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ResultStore.open(tmp_path, replace(PaperPlan.load("tiny"), passes=7))
    code, err = _run(capsys, "--preset", "tiny", "--out", str(tmp_path), "--only", "data")
    assert (code, err.count("\n")) == (2, 1)
    assert "got another plan; choose another folder" in err


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way", "utf-8")
    code, err = _run(capsys, "--preset", "tiny", "--out", str(tmp_path / "file" / "study"))
    assert (code, err.count("\n")) == (2, 1)


def test_without_torch_trainings_say_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setitem(sys.modules, "lightning", None)
    code, err = _run(capsys, "--preset", "tiny", "--out", str(tmp_path), "--only", "models")
    assert (code, err.count("\n")) == (2, 1)
    assert "pip install 'viewshed-lab[train]'" in err


def test_without_a_graphics_card_cuda_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: training is not tested")
    if torch.cuda.is_available():
        pytest.skip("there is a graphics card")
    code, err = _run(capsys, "--preset", "tiny", "--out", str(tmp_path), "--only", "pairs", "--device", "cuda")
    assert (code, err.count("\n")) == (2, 1)
    assert "device cuda needs 1 graphics card" in err
