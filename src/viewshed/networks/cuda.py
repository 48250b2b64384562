"""ONNX Runtime on a graphics card, or an error that says what is missing: never on the processor instead."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from typing import Any

_CPU, _CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"
_SETTINGS = {"use_tf32": "0", "cudnn_conv_algo_search": "HEURISTIC"}
"""Products in float32, and the way to convolve chosen without trying all of them for every size of a batch."""
_FATAL, _WARNING = 4, 2
_INSTALL = "pip install 'onnxruntime-gpu[cuda,cudnn]'"
_INSTEAD = "or take the engine onnxruntime (--device cpu)"

Run = Callable[[Sequence[str], Mapping[str, Any]], list[Any]]
"""From names of outputs, and inputs by name, to these outputs."""


def on_card(content: bytes) -> Run:
    """Return what runs a network, known to be sound, on the first graphics card; it raises an OSError if that fails.

    Raises:
        ImportError: this ONNX Runtime has no CUDA.
        ValueError: there is no graphics card that it can use.
    """
    session = _session(content)

    def run(names: Sequence[str], inputs: Mapping[str, Any]) -> list[Any]:
        try:
            found: list[Any] = session.run(names, inputs)
        except Exception as error:  # its errors share no class but this
            raise OSError(
                f"the graphics card failed ({_first_line(str(error))}); free its memory, {_INSTEAD}"
            ) from error
        return found

    return run


def _session(content: bytes) -> Any:
    import onnxruntime

    if _CUDA not in onnxruntime.get_available_providers():
        raise ImportError(
            "engine cuda needs an ONNX Runtime with CUDA, and the one installed has none; run: pip uninstall -y"
            f" onnxruntime; {_INSTALL}; {_INSTEAD}"
        )
    options = onnxruntime.SessionOptions()
    options.log_severity_level = _FATAL
    onnxruntime.set_default_logger_severity(_FATAL)  # what it would say at length is said below in a line
    why = _preloaded(onnxruntime)
    try:
        providers = [(_CUDA, _SETTINGS), _CPU]
        session = onnxruntime.InferenceSession(content, options, providers=providers, enable_fallback=False)
    except Exception as error:  # its errors share no class but this
        raise ValueError(_no_card(_first_line(str(error)))) from error
    finally:
        onnxruntime.set_default_logger_severity(_WARNING)
    if _CUDA not in session.get_providers():
        raise ValueError(_no_card(why))
    return session


def _preloaded(onnxruntime: Any) -> str:
    """Load the libraries of CUDA that pip installed, if any, and return what is missing."""
    preload, told = getattr(onnxruntime, "preload_dlls", None), io.StringIO()
    if preload is not None:  # it is there from 1.21 on
        with redirect_stdout(told):
            preload()
    return _first_line(told.getvalue()) or "no card or no driver"


def _no_card(why: str) -> str:
    return (
        f"engine cuda needs a graphics card, and ONNX Runtime found none that it can use ({why}); see that nvidia-smi"
        f" shows one, and run: {_INSTALL}; {_INSTEAD}"
    )


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0][:120]
