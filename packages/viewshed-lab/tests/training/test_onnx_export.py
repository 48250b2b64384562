import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from tests.networks.made import GRID, SMALL, card, drawn, inputs
from tests.networks.older import with_second_head

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import FORMAT_VERSION, NetworkCard
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import with_checksum
from viewshed_lab.training.onnx_export import export_onnx, onnx_model
from viewshed_lab.training.unet_torch import TorchRunner

SHAPES = [SMALL, UNetShape(8, 4), UNetShape(2, 1, 0.5), UNetShape(3, 3, 0.2)]
CUDA = "CUDAExecutionProvider"
HAS_CARD = torch.cuda.is_available() and CUDA in onnxruntime.get_available_providers()
ENGINES = ["onnxruntime"]
ENGINES += ["cuda"] if HAS_CARD else []


@pytest.fixture
def path(tmp_path: Path) -> Path:
    export_onnx(tmp_path / "net.onnx", card(), drawn())
    return tmp_path / "net.onnx"


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_file_says_what_torch_says(shape: UNetShape, engine: str, tmp_path: Path) -> None:
    module = drawn(shape)
    export_onnx(tmp_path / "a.onnx", card(shape), module)
    runner, torch_runner = OnnxRunner(tmp_path / "a.onnx", 1, engine), TorchRunner(card(shape), module)
    masks = shape.masks(5, np.random.default_rng(2))
    for x, m in ((inputs(1), masks), (inputs(5), masks), (inputs(2), shape.no_masks(2))):
        expected = torch_runner.run(x, m)
        assert expected.std() > 0.005
        np.testing.assert_allclose(runner.run(x, m), expected, atol=2e-6)
    first, *rest = runner.run(inputs(1), masks)
    assert max(np.abs(first - other).max() for other in rest) > 1e-3
    assert runner.card == card(shape)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_older_files_with_a_second_head_give_their_probability(shape: UNetShape, engine: str, tmp_path: Path) -> None:
    model = onnx_model(card(shape), drawn(shape))
    export_onnx(tmp_path / "a.onnx", card(shape), drawn(shape))
    older = OnnxRunner.of_content(with_checksum(with_second_head(model).SerializeToString()), "older", 1, engine)
    runner = OnnxRunner(tmp_path / "a.onnx", 1, engine)
    assert older.card == runner.card
    for m in (shape.no_masks(1), shape.masks(3, np.random.default_rng(2))):
        np.testing.assert_allclose(older.run(inputs(1), m), runner.run(inputs(1), m), atol=1e-6)


def test_many_passes_in_parts_are_the_same(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner, masks = OnnxRunner(path, 1, "onnxruntime"), SMALL.masks(7, np.random.default_rng(2))
    whole = runner.run(inputs(1), masks), runner.run(inputs(7), masks)
    monkeypatch.setattr("viewshed.networks.runtime._MAX_CELLS_PER_RUN", 3 * GRID.cells**2)
    parts = runner.run(inputs(1), masks), runner.run(inputs(7), masks)
    np.testing.assert_allclose(parts, whole, atol=1e-6)


def test_the_file_is_sound_onnx_with_its_card_and_checksum(path: Path) -> None:
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    told = {each.key: each.value for each in model.metadata_props}
    assert NetworkCard.from_json(told["viewshed.card"]) == card()
    end = path.read_bytes().rindex(b"viewshed.sha256") - 4
    assert told["viewshed.sha256"] == hashlib.sha256(path.read_bytes()[:end]).hexdigest()
    assert {each.op_type for each in model.graph.node}.isdisjoint({"Dropout", "RandomUniformLike", "Bernoulli"})


@pytest.mark.parametrize("engine", ENGINES)
def test_damaged_and_other_files_are_refused(path: Path, engine: str) -> None:
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    other_version = onnx_model(card(), drawn())
    other_version.metadata_props[0].value = card().to_json().replace(f'"version": {FORMAT_VERSION}', '"version": 9')
    bare = onnx_model(card(), drawn())
    del bare.metadata_props[:]
    cases = {
        whole[: len(whole) // 2]: "must be a network that viewshed exported, got a file that is cut short or another",
        b"": "must be a network that viewshed exported, got a file that is cut short or another; copy it again",
        bytes(flipped): r"must have the checksum \w{10}…, got \w{10}…: it is damaged; copy it again",
        bare.SerializeToString(): "must be a network that viewshed exported, got a file that is cut short or another",
        with_checksum(b"\x99 no model"): "must be a network in ONNX, got another file",
        with_checksum(bare.SerializeToString()): "card must be JSON",
        with_checksum(
            other_version.SerializeToString()
        ): f"network must have format version {FORMAT_VERSION}, got 9; train it again",
    }
    for content, message in cases.items():
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message) as caught:
            OnnxRunner(path, engine=engine)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


def test_arrays_of_other_shapes_are_refused(path: Path) -> None:
    runner, masks = OnnxRunner(path, 1, "onnxruntime"), SMALL.no_masks(2)
    with pytest.raises(
        ValueError, match=r"inputs must be float32 of shape \(N, 1, 32, 32\), got float32 of shape \(2, 1"
    ):
        runner.run(inputs(2)[..., :16], masks)
    with pytest.raises(ValueError, match=r"inputs must be float32 of shape .*, got float64"):
        runner.run(inputs(2).astype(np.float64), masks)
    with pytest.raises(ValueError, match=r"masks must be float32 of shape \(N, 32\) with N at least 1, got float32"):
        runner.run(inputs(2), masks[:, 1:])
    with pytest.raises(ValueError, match=r"masks must be float32 of shape .* with N at least 1, got .*\(0, 32\)"):
        runner.run(inputs(1), masks[:0])
    with pytest.raises(ValueError, match=r"inputs must be 1 or as many as masks \(2\), got 3"):
        runner.run(inputs(3), masks)


def test_an_onnxruntime_without_cuda_is_named_with_the_repair(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(
        ImportError, match="engine cuda needs an ONNX Runtime with CUDA, and the one installed"
    ) as caught:
        OnnxRunner(path, engine="cuda")
    for repair in ("pip install 'onnxruntime-gpu[cuda,cudnn]'", "or take the engine onnxruntime (--device cpu)"):
        assert repair in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(HAS_CARD, reason="there is a graphics card")
@pytest.mark.filterwarnings("ignore:Specified provider")
def test_the_processor_never_stands_in_for_the_graphics_card(
    path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CUDA, "CPUExecutionProvider"])
    with pytest.raises(ValueError, match="engine cuda needs a graphics card, and ONNX Runtime found none") as caught:
        OnnxRunner(path, engine="cuda")
    assert "or take the engine onnxruntime (--device cpu)" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_file_loads_by_its_path_and_an_unknown_name_does_not(path: Path) -> None:
    assert load_runner(path, 1).card == load_runner(str(path), 1).card == card()
    with pytest.raises(ValueError, match=r"weights must be a file that viewshed train exported .*, got 'no_such'"):
        load_runner("no_such")


def test_running_needs_no_torch(path: Path) -> None:
    code = (
        "import sys, numpy as np; from viewshed.networks.runtime import load_runner; r = load_runner(sys.argv[1], 1);"
        "r.run(np.zeros((1, 1, 32, 32), np.float32), r.card.shape.no_masks(1));"
        "print(sorted({'torch', 'onnx', 'lightning'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
