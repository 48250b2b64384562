"""Runs an exported network without torch: ONNX Runtime on the processor, or on request with CUDA.

``cuda`` runs on the graphics card or raises an error that says what is missing: it never falls back to the processor.
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
"""Products in float32, and the way to convolve chosen without trying all of them for every size of a batch."""

_FATAL, _WARNING = 4, 2

_INSTALL = "pip install 'onnxruntime-gpu[cuda,cudnn]'"

_INSTEAD = "or take the engine onnxruntime (--device cpu)"

Run = Callable[[Sequence[str], Mapping[str, Any]], list[Any]]
"""From names of outputs, and inputs by name, to these outputs."""


def cuda_run(content: bytes) -> Run:
    """Return what runs a network, known to be sound, on the first graphics card; it raises an OSError if that fails.

    Raises:
        ImportError: this ONNX Runtime has no CUDA.
        ValueError: there is no graphics card that it can use.
    """
    session = _cuda_session(content)

    def run(names: Sequence[str], inputs: Mapping[str, Any]) -> list[Any]:
        try:
            outputs: list[Any] = session.run(names, inputs)
        except Exception as error:  # its errors share no class but this
            raise OSError(
                f"the graphics card failed ({_first_line(str(error))}); free its memory, {_INSTEAD}"
            ) from error
        return outputs

    return run


def _cuda_session(content: bytes) -> Any:
    import onnxruntime

    if _CUDA not in onnxruntime.get_available_providers():
        raise ImportError(
            "engine cuda needs an ONNX Runtime with CUDA, and the one installed has none; run: pip uninstall -y"
            f" onnxruntime; {_INSTALL}; {_INSTEAD}"
        )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = _FATAL
    onnxruntime.set_default_logger_severity(_FATAL)  # its long messages are reported below in a line
    why = _preload_cuda(onnxruntime)
    try:
        providers = [(_CUDA, _SETTINGS), _CPU]
        session = onnxruntime.InferenceSession(content, options, providers=providers, enable_fallback=False)
    except Exception as error:  # its errors share no class but this
        raise ValueError(_no_card_message(_first_line(str(error)))) from error
    finally:
        onnxruntime.set_default_logger_severity(_WARNING)
    if _CUDA not in session.get_providers():
        raise ValueError(_no_card_message(why))
    return session


def _preload_cuda(onnxruntime: Any) -> str:
    """Load the libraries of CUDA that pip installed, if any, and return what is missing."""
    preload, output = getattr(onnxruntime, "preload_dlls", None), io.StringIO()
    if preload is not None:  # it is there from 1.21 on
        with redirect_stdout(output):
            preload()
    return _first_line(output.getvalue()) or "no card or no driver"


def _no_card_message(why: str) -> str:
    return (
        f"engine cuda needs a graphics card, and ONNX Runtime found none that it can use ({why}); see that nvidia-smi"
        f" shows one, and run: {_INSTALL}; {_INSTEAD}"
    )


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0][:120]


ENGINES = ("onnxruntime", "cuda")
"""What can run a network; ``cuda`` is ONNX Runtime on a graphics card, in float32 without TF32."""

IN_BYTES = "onnxruntime"
"""The engine that runs networks in bytes."""

_CELLS_AT_ONCE = 1 << 21

Call = Callable[[Mapping[str, NDArray[Any]], Sequence[str]], list[F32]]
"""From inputs by name and names of outputs to these."""


class OnnxRunner:
    """Runs a network that :func:`viewshed_lab.training.onnx_export.export_onnx` wrote.

    With dropout off the graph that runs has no masks (:mod:`viewshed.networks.deterministic`); the one with masks is
    made when it is first run.

    Args:
        path: the file; its checksum is compared, and what it would run is bounded by its card
            (:mod:`viewshed.networks.inspection`) before anything runs. The checksum finds damage, not forgery: take
            networks from people whose statements you trust.
        threads: threads of one run; None leaves it to the engine (one for each core).
        engine: one of ``ENGINES``.

    Raises:
        ValueError: the file is damaged, another, of another version, or asks for more than a network of ours; or the
            engine cannot do what is required.
        OSError: it cannot be read.
        ImportError: the engine is not installed.

    A run raises a ValueError if the network fails, with ``cuda`` an OSError if the graphics card does.
    """

    _alone: OnnxRunner | None

    def __init__(self, path: str | Path, threads: int | None = None, engine: str = "onnxruntime") -> None:
        self._start(Path(path).read_bytes(), str(path), threads, engine)

    @classmethod
    def of_content(
        cls, content: bytes, name: str, threads: int | None = None, engine: str = "onnxruntime"
    ) -> OnnxRunner:
        """Return the runner of a file's ``content``; ``name`` stands for it in messages."""
        runner = cls.__new__(cls)
        runner._start(content, name, threads, engine)
        return runner

    def _start(self, content: bytes, name: str, threads: int | None, engine: str) -> None:
        self._content, self._name, self._threads, self._alone = content, name, threads, None
        verify_checksum(content, name)
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        if engine not in ENGINES:
            raise ValueError(f"engine must be one of {', '.join(ENGINES)}, got {engine!r}")
        self.engine = engine
        self.card = inspect_network(content, name)
        if self.card.precision == INT8 and engine != IN_BYTES:
            raise ValueError(
                f"engine must be {IN_BYTES} for {name}, a network in bytes, got {engine}, which is for networks in"
                " float32; give the network in float32"
            )
        deterministic = without_masks(content)
        if engine == "cuda":
            self._load(deterministic, "onnxruntime")  # proves the file sound before a graphics card is looked for
        self._deterministic = self._load(deterministic, engine)

    @cached_property
    def _with_masks(self) -> Call:
        """The graph as it is in the file."""
        return self._load(self._content, self.engine)

    def _load(self, content: bytes, engine: str) -> Call:
        """Return what runs a graph of this file in an engine."""
        try:
            call = _LOADERS[engine](content, self._threads)
        except RuntimeError as error:
            raise ValueError(f"{self._name} must be a network in ONNX, got another file ({_short(error)})") from error
        return call if engine == "cuda" else _with_file_name(call, self._name)

    def single_threaded(self) -> OnnxRunner | None:
        """Return the same network, each run of it in one thread, for runs in several threads at once.

        None where the engine gains nothing by that or runs one at a time.
        """
        if self._alone is None and self.engine == "onnxruntime":
            self._alone = OnnxRunner.of_content(self._content, self._name, 1)
        return self._alone

    def run(self, inputs: NDArray[Any], masks: F32 | None = None) -> F32:
        """Return probabilities (N, cells, cells); see :class:`viewshed.networks.card.Runner`."""
        self._check(inputs, masks)
        count, step = len(inputs if masks is None else masks), max(_CELLS_AT_ONCE // self.card.grid.cells**2, 1)
        if count > step:
            parts = [slice(start, start + step) for start in range(0, count, step)]
            shared = len(inputs) == 1
            return np.concatenate([
                self.run(inputs if shared else inputs[part], None if masks is None else masks[part]) for part in parts
            ])  # fmt: skip
        if masks is None:
            [found] = self._deterministic({"inputs": inputs}, ["probability"])
        else:
            [found] = self._with_masks({"inputs": inputs, "masks": masks}, ["probability"])
        return np.minimum(found, np.float32(1.0))  # the engine's sigmoid may say 1.0000001

    def _check(self, inputs: NDArray[Any], masks: F32 | None) -> None:
        card = self.card
        one, dtype = card.input_shape, "uint8" if card.precision == INT8 else "float32"
        if inputs.ndim != 4 or inputs.shape[1:] != one or inputs.dtype != dtype:
            raise ValueError(f"inputs must be {dtype} of shape (N, {', '.join(map(str, one))}), got {_kind(inputs)}")
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
    """Return the runner of a file, or of the weights of that name that viewshed ships.

    Raises:
        ValueError: no such name and no such file, or a file that cannot be used.
    """
    name = str(path_or_name)
    if name in shipped_names():
        return OnnxRunner.of_content(shipped_content(name), name, threads, engine)
    if not Path(path_or_name).is_file():
        raise ValueError(f"weights must be {_choices()}, got {name!r}, which is neither")
    return OnnxRunner(path_or_name, threads, engine)


def _choices() -> str:
    names = ", ".join(shipped_names())
    return (
        f"a file that viewshed train exported or one of {names}"
        if names
        else ("a file that viewshed train exported (this version ships none by name)")
    )


def _with_file_name(call: Call, name: str) -> Call:
    """Give whatever an engine raises while a network runs one line that names its file."""

    def run(inputs: Mapping[str, NDArray[Any]], names: Sequence[str]) -> list[F32]:
        try:
            return call(inputs, names)
        except Exception as error:  # engines raise whatever their parts raise
            raise ValueError(f"{name} cannot be run ({_short(error)}); export it again with viewshed train") from error

    return run


def values_of(content: bytes, threads: int | None = None) -> Call:
    """Return what runs a model for any of its outputs; without reading its card or checking a checksum."""
    session = _session(content, threads)
    return lambda inputs, names: list(session.run(names, inputs))


def may_saturate(machine: str, cpu_info: str) -> bool:
    """Return whether sums of products of bytes saturate on a processor: an x86 without VNNI, or not known to have it.

    Args:
        machine: kind of processor, of ``platform.machine``.
        cpu_info: what Linux tells of it in ``/proc/cpuinfo``; empty elsewhere.

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


MOST_BYTES = 8 << 30
"""Memory of all networks that run in a process; more is an error of the run, whatever a file asks for."""


@lru_cache(maxsize=1)
def _limit_memory() -> None:
    """Let all sessions take their memory from one pool of at most ``MOST_BYTES``."""
    import onnxruntime

    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, onnxruntime.OrtMemType.DEFAULT
    limit = onnxruntime.OrtArenaCfg({"max_mem": MOST_BYTES})
    onnxruntime.create_and_register_allocator(onnxruntime.OrtMemoryInfo("Cpu", *kind), limit)


def _session(content: bytes, threads: int | None) -> Any:
    import onnxruntime

    _limit_memory()
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = threads or 0
    options.log_severity_level = 3
    # Threads that wait for the next layer, or the next sweep, would take the cores from the rest of the estimate.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if _bytes_may_saturate():
        options.add_session_config_entry("session.x64quantprecision", "1")  # exact, and two to four times as slow
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors share no class but this
        raise RuntimeError(_short(error)) from error


def _cuda(content: bytes, threads: int | None) -> Call:
    run = cuda_run(content)
    return lambda inputs, names: run(names, inputs)


_LOADERS: dict[str, Callable[[bytes, int | None], Call]] = {"onnxruntime": values_of, "cuda": _cuda}
"""What makes a call of a model, by engine."""


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]


def _kind(array: NDArray[Any]) -> str:
    return f"{array.dtype} of shape {array.shape}"
