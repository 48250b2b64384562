"""Golden arrays on disk: their format, and how far an estimate may differ from them.

``arrays/METHOD.npz.xz`` holds ``names`` (n,), ``state`` (n, 256, 256) and, where they add to the state,
``prob`` and ``std`` as round(255 x), all uint8. Probabilities and deviations of networks hardly compress, so only every
second row and column is stored; states and the probabilities of the others are complete. A method without ``prob``
claims exactly its FREE and SURFACE cells; one without ``std`` has no deviation.

``arrays/manifest.json`` records their inputs. The real sweeps are not in the repository; the manifest has their paths
and checksums.
"""

from __future__ import annotations

import hashlib
import io
import json
import lzma
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.golden import recorder
from tests.golden.recorder import Arrays, SweepName

FOLDER = Path(__file__).parent / "arrays"
MANIFEST = FOLDER / "manifest.json"
SHARE = 1e-4
"""Largest share of all cells of a method, over all its sweeps, that may differ on another processor."""
SWEEP_SHARE = 1e-3
"""Largest share of the cells of one sweep that may differ."""
_NO_STD = 255
_Bytes = NDArray[np.uint8]


def save(method: str, estimates: Mapping[str, Arrays]) -> None:
    """Write the estimates of a method, by the names of the sweeps."""
    table: dict[str, Any] = {"names": np.array(list(estimates))}
    table["state"] = np.stack([arrays.state for arrays in estimates.values()])
    prob, std = (np.stack([getattr(arrays, name) for arrays in estimates.values()]) for name in ("prob", "std"))
    step = _step(method)
    if not np.array_equal(prob, _certain(table["state"])):
        table["prob"] = prob[:, ::step, ::step]
    if (std != _NO_STD).any():
        table["std"] = std[:, ::step, ::step]
    buffer = io.BytesIO()
    np.savez(buffer, **table)
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{method}.npz.xz").write_bytes(lzma.compress(buffer.getvalue(), preset=9 | lzma.PRESET_EXTREME))


def load(method: str) -> dict[str, Arrays]:
    """Return the golden estimates of a method by sweep name; prob and std of networks at every second row, column."""
    step = _step(method)
    content = lzma.decompress((FOLDER / f"{method}.npz.xz").read_bytes())
    with np.load(io.BytesIO(content), allow_pickle=False) as table:
        state = table["state"]
        coarse = state[:, ::step, ::step]
        prob = table["prob"] if "prob" in table else _certain(coarse)
        std = table["std"] if "std" in table else np.full(coarse.shape, _NO_STD, np.uint8)
        return {str(name): Arrays(*arrays) for name, *arrays in zip(table["names"], state, prob, std, strict=True)}


def checksum(name: SweepName, real_data: Path) -> str | None:
    """Return the sha256 of the file of a real sweep, None for a simulated one."""
    if name.source != "real":
        return None
    return hashlib.sha256((real_data / name.place).read_bytes()).hexdigest()


def sweeps_of_manifest() -> dict[str, Any]:
    """Return the manifest's entry for each sweep, by its name."""
    table: dict[str, Any] = json.loads(MANIFEST.read_text(encoding="utf-8"))["sweeps"]
    return table


def differences(names: Iterable[SweepName], real_data: Path | None) -> list[str]:
    """Return one line for each method and quantity outside the tolerance, over the sweeps ``names``."""
    golden: dict[str, dict[str, Arrays]] = {}
    wrong: defaultdict[tuple[str, str], dict[str, tuple[int, int]]] = defaultdict(dict)
    lines, known = [], sweeps_of_manifest()
    for name in names:
        if real_data is not None and checksum(name, real_data) != known[str(name)].get("sha256"):
            lines.append(f"{name}: the file is not the one that the arrays were made of")
            continue
        sweep = recorder.sweep_of(name, real_data)
        for method in recorder.methods_of(name):
            if method not in golden:
                golden[method] = load(method)
            actual = recorder.estimate(method, name, sweep)
            for quantity, mask in _differing(method, actual, golden[method][str(name)]).items():
                wrong[method, quantity][str(name)] = int(mask.sum()), mask.size
    return lines + [line for key, counts in wrong.items() for line in _judged(key, counts)]


def _differing(method: str, actual: Arrays, expected: Arrays) -> dict[str, NDArray[np.bool_]]:
    step = _step(method)
    prob, std = (
        np.abs(ours[::step, ::step].astype(np.int16) - theirs) > 1
        for ours, theirs in ((actual.prob, expected.prob), (actual.std, expected.std))
    )
    return {"state": actual.state != expected.state, "prob": prob, "std": std}


def _judged(key: tuple[str, str], counts: Mapping[str, tuple[int, int]]) -> Iterable[str]:
    """Yield one line for a quantity of a method that differs in too many cells, with its worst sweeps."""
    wrong, cells = (sum(column) for column in zip(*counts.values(), strict=True))
    worst = sorted(counts, key=lambda name: -counts[name][0])[:3]
    if wrong > SHARE * cells or any(count > SWEEP_SHARE * size for count, size in counts.values()):
        shown = ", ".join(f"{name} ({counts[name][0]} of {counts[name][1]})" for name in worst)
        yield f"{key[0]}: {key[1]} differs in {wrong} of {cells} cells of {len(counts)} sweeps; most in {shown}"


def _certain(state: _Bytes) -> _Bytes:
    """Return the uint8 probability of a method that is certain of its states: 255 where FREE or SURFACE."""
    return np.where((state == 1) | (state == 2), np.uint8(255), np.uint8(0))


def _step(method: str) -> int:
    return 2 if method in recorder.LEARNED else 1
