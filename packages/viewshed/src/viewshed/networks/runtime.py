"""Inference of exported networks without torch: ONNX Runtime on the CPU, or on request with CUDA.

``cuda`` runs on the GPU or raises an error that names what is missing; it never falls back to the CPU.
"""

from __future__ import annotations

import io
import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.networks.card import INT8
from viewshed.networks.deterministic import without_masks
from viewshed.networks.inspection import inspect_network
from viewshed.networks.weights import shipped_content, shipped_names, verify_checksum

_CPU, _CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"

_SETTINGS = {"use_tf32": "0", "cudnn_conv_algo_search": "HEURISTIC"}
"""Float32 products without TF32; convolution algorithms by heuristic, not by exhaustive search per batch size."""

_FATAL, _WARNING = 4, 2

_INSTALL = "pip install 'onnxruntime-gpu[cuda,cudnn]'"

_INSTEAD = "or take the engine onnxruntime (--device cpu)"

Call = Callable[[Mapping[str, NDArray[Any]], Sequence[str]], list[F32]]
"""Function from inputs by name and names of outputs to the outputs."""


def _cuda(content: bytes, _: int | None) -> Call:
    """Return a function that runs a validated network on the first GPU; it raises OSError if the GPU fails.

    Raises:
        ImportError: the installed ONNX Runtime has no CUDA.
        ValueError: there is no usable GPU.
    """
    import onnxruntime

    if _CUDA not in onnxruntime.get_available_providers():
        raise ImportError(
            "engine cuda needs an ONNX Runtime with CUDA, and the one installed has none; run: pip uninstall -y"
            f" onnxruntime; {_INSTALL}; {_INSTEAD}"
        )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = _FATAL
    onnxruntime.set_default_logger_severity(_FATAL)  # its long messages are shortened to one line below
    missing = _preload_cuda(onnxruntime)
    try:
        providers = [(_CUDA, _SETTINGS), _CPU]
        session = onnxruntime.InferenceSession(content, options, providers=providers, enable_fallback=False)
    except Exception as error:  # ONNX Runtime's errors have no other common base class
        raise ValueError(_no_gpu_message(_first_line(str(error)))) from error
    finally:
        onnxruntime.set_default_logger_severity(_WARNING)
    if _CUDA not in session.get_providers():
        raise ValueError(_no_gpu_message(missing))

    def run(inputs: Mapping[str, NDArray[Any]], names: Sequence[str]) -> list[F32]:
        try:
            return list(session.run(names, inputs))
        except Exception as error:  # ONNX Runtime's errors have no other common base class
            raise OSError(
                f"the graphics card failed ({_first_line(str(error))}); free its memory, {_INSTEAD}"
            ) from error

    return run


def _preload_cuda(onnxruntime: Any) -> str:
    """Load the CUDA libraries that pip installed, if any, and return a line that says what is missing."""
    preload, output = getattr(onnxruntime, "preload_dlls", None), io.StringIO()
    if preload is not None:  # since ONNX Runtime 1.21
        with redirect_stdout(output):
            preload()
    return _first_line(output.getvalue()) or "no card or no driver"


def _no_gpu_message(cause: str) -> str:
    return (
        f"engine cuda needs a graphics card, and ONNX Runtime found none that it can use ({cause}); see that nvidia-smi"
        f" shows one, and run: {_INSTALL}; {_INSTEAD}"
    )


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0][:120]


ENGINES = ("onnxruntime", "cuda")
"""Inference engines; ``cuda`` is ONNX Runtime on a GPU, in float32 without TF32."""

INT8_ENGINE = "onnxruntime"
"""The engine of int8 networks."""

_MAX_CELLS_PER_RUN = 1 << 21


class OnnxRunner:
    """Runner of a network exported by :func:`viewshed_lab.training.onnx_export.export_onnx`.

    Without dropout it runs a graph without masks (:mod:`viewshed.networks.deterministic`); the graph with masks is
    loaded on its first run.

    Args:
        path: path of the file. Its checksum and its content (:mod:`viewshed.networks.inspection`) are verified before
            anything runs. The checksum detects damage, not forgery: use networks only from trusted sources.
        threads: number of threads of one run; None lets the engine decide (one per core).
        engine: one of ``ENGINES``.

    Raises:
        ValueError: the file is damaged, no network of viewshed or of another version; or the engine cannot run it.
        OSError: the file cannot be read.
        ImportError: the engine is not installed.

    A run raises ValueError if the network fails; with ``cuda``, OSError if the GPU fails.
    """

    _single_threaded: OnnxRunner | None

    def __init__(self, path: str | Path, threads: int | None = None, engine: str = "onnxruntime") -> None:
        self._start(Path(path).read_bytes(), str(path), threads, engine)

    @classmethod
    def of_content(
        cls, content: bytes, name: str, threads: int | None = None, engine: str = "onnxruntime"
    ) -> OnnxRunner:
        """Return the runner of a file's ``content``; ``name`` is the file's name in messages."""
        runner = cls.__new__(cls)
        runner._start(content, name, threads, engine)
        return runner

    def _start(self, content: bytes, name: str, threads: int | None, engine: str) -> None:
        self._content, self._name, self._threads, self._single_threaded = content, name, threads, None
        verify_checksum(content, name)
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        if engine not in ENGINES:
            raise ValueError(f"engine must be one of {', '.join(ENGINES)}, got {engine!r}")
        self.engine = engine
        self.card = inspect_network(content, name)
        if self.card.precision == INT8 and engine != INT8_ENGINE:
            raise ValueError(
                f"engine must be {INT8_ENGINE} for {name}, a network with 8-bit weights, got {engine}, which is for"
                " networks in float32; give the network in float32"
            )
        deterministic = without_masks(content)
        if engine == "cuda":
            self._load(deterministic, "onnxruntime")  # check that the CPU can load the file before looking for a GPU
        self._deterministic = self._load(deterministic, engine)

    @cached_property
    def _with_masks(self) -> Call:
        """Function that runs the graph of the file, which has masks as an input."""
        return self._load(self._content, self.engine)

    def _load(self, content: bytes, engine: str) -> Call:
        """Return a function that runs a graph of this file in an engine."""
        try:
            call = _LOADERS[engine](content, self._threads)
        except RuntimeError as error:
            raise ValueError(f"{self._name} must be a network in ONNX, got another file ({_short(error)})") from error
        return call if engine == "cuda" else _with_file_name(call, self._name)

    def single_threaded(self) -> OnnxRunner | None:
        """Return a runner of the same network with one thread per run, to call from several threads at once.

        None for ``cuda``, which gains nothing from this.
        """
        if self._single_threaded is None and self.engine == "onnxruntime":
            self._single_threaded = OnnxRunner.of_content(self._content, self._name, 1)
        return self._single_threaded

    def run(self, inputs: NDArray[Any], masks: F32 | None = None) -> F32:
        """Return probabilities (N, cells, cells); see :class:`viewshed.networks.card.Runner`."""
        self._check(inputs, masks)
        count, step = len(inputs if masks is None else masks), max(_MAX_CELLS_PER_RUN // self.card.grid.cells**2, 1)
        if count > step:
            parts = [slice(start, start + step) for start in range(0, count, step)]
            shared = len(inputs) == 1
            return np.concatenate([
                self.run(inputs if shared else inputs[part], None if masks is None else masks[part]) for part in parts
            ])  # fmt: skip
        if masks is None:
            [prob] = self._deterministic({"inputs": inputs}, ["probability"])
        else:
            [prob] = self._with_masks({"inputs": inputs, "masks": masks}, ["probability"])
        return np.minimum(prob, np.float32(1.0))  # the engine's sigmoid may return 1.0000001

    def _check(self, inputs: NDArray[Any], masks: F32 | None) -> None:
        card = self.card
        shape, dtype = card.input_shape, "uint8" if card.precision == INT8 else "float32"
        if inputs.ndim != 4 or inputs.shape[1:] != shape or inputs.dtype != dtype:
            raise ValueError(f"inputs must be {dtype} of shape (N, {', '.join(map(str, shape))}), got {_kind(inputs)}")
        if not len(inputs):
            raise ValueError("inputs must be at least one, got none")
        if masks is None:
            return
        total = sum(card.shape.masked_channels)
        if masks.ndim != 2 or masks.shape[1] != total or not len(masks) or masks.dtype != np.float32:
            raise ValueError(f"masks must be float32 of shape (N, {total}) with N at least 1, got {_kind(masks)}")
        if len(inputs) not in (1, len(masks)):
            raise ValueError(f"inputs must be 1 or as many as masks ({len(masks)}), got {len(inputs)}")


def load_runner(path_or_name: str | Path, threads: int | None = None, engine: str = "onnxruntime") -> OnnxRunner:
    """Return the runner of a file, or of shipped weights by name.

    Raises:
        ValueError: no shipped weights and no file have this name, or the file cannot be used.
    """
    name = str(path_or_name)
    if name in shipped_names():
        return OnnxRunner.of_content(shipped_content(name), name, threads, engine)
    if not Path(path_or_name).is_file():
        raise ValueError(f"weights must be {_choices()}, got {name!r}, which is neither")
    return OnnxRunner(path_or_name, threads, engine)


def _choices() -> str:
    names = ", ".join(shipped_names())
    none = " (this version ships none by name)"
    return "a file that viewshed train exported" + (f" or one of {names}" if names else none)


def _with_file_name(call: Call, name: str) -> Call:
    """Return ``call`` with exceptions of the engine turned into a ValueError of one line that names the file."""

    def run(inputs: Mapping[str, NDArray[Any]], names: Sequence[str]) -> list[F32]:
        try:
            return call(inputs, names)
        except Exception as error:  # engines raise any exception
            raise ValueError(f"{name} cannot be run ({_short(error)}); export it again with viewshed train") from error

    return run


def values_of(content: bytes, threads: int | None = None) -> Call:
    """Return a function that runs a model for any of its outputs, without checks of card and checksum."""
    session = _session(content, threads)
    return lambda inputs, names: list(session.run(names, inputs))


def may_saturate(machine: str, cpu_info: str) -> bool:
    """Return whether sums of int8 products may saturate on a CPU: an x86 that is not known to have VNNI.

    Args:
        machine: ``platform.machine()``.
        cpu_info: content of ``/proc/cpuinfo``; empty on other systems than Linux.

    >>> may_saturate("x86_64", "flags: sse2 avx2"), may_saturate("x86_64", "flags: avx2 avx512_vnni")
    (True, False)
    >>> may_saturate("arm64", "")
    False
    """
    is_x86 = machine.lower() in {"x86_64", "amd64", "i386", "i686"}
    return is_x86 and not {"avx512_vnni", "avx_vnni"} & set(cpu_info.split())


@lru_cache(maxsize=1)
def _bytes_may_saturate() -> bool:
    cpu_info = Path("/proc/cpuinfo")
    return may_saturate(platform.machine(), cpu_info.read_text(encoding="utf-8") if cpu_info.exists() else "")


MAX_MEMORY_BYTES = 8 << 30
"""Maximum memory of all networks of a process; a run that needs more fails."""


@lru_cache(maxsize=1)
def _limit_memory() -> None:
    """Make all sessions share one memory pool of at most ``MAX_MEMORY_BYTES``."""
    import onnxruntime

    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, onnxruntime.OrtMemType.DEFAULT
    limit = onnxruntime.OrtArenaCfg({"max_mem": MAX_MEMORY_BYTES})
    onnxruntime.create_and_register_allocator(onnxruntime.OrtMemoryInfo("Cpu", *kind), limit)


def _session(content: bytes, threads: int | None) -> Any:
    import onnxruntime

    _limit_memory()
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = threads or 0
    options.log_severity_level = 3
    # Idle threads must not spin: they would take the cores from the rest of the estimate.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if _bytes_may_saturate():
        options.add_session_config_entry("session.x64quantprecision", "1")  # exact, but two to four times as slow
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's errors have no other common base class
        raise RuntimeError(_short(error)) from error


_LOADERS: dict[str, Callable[[bytes, int | None], Call]] = {"onnxruntime": values_of, "cuda": _cuda}
"""Engine → function that loads a model."""


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]


def _kind(array: NDArray[Any]) -> str:
    return f"{array.dtype} of shape {array.shape}"
