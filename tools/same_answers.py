"""Compare the answers of two versions of viewshed: on every real sweep and on simulated ones, attacked ones among them.

    python tools/same_answers.py CHECKOUT [--simulated 1000] [--data FOLDER] [--out docs/results/same_answers.md]

CHECKOUT holds the other version, built. Both versions read the same files and estimate them by the same methods, each
in a process of its own. Compared are the states of all cells, and the visible cells: F1 of one version's against the
other's. The exit code is 1 if less than 99.9 % of the cells agree in any method.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from with_checkout import environment_of

ROOT = Path(__file__).resolve().parents[1]
METHODS = ("shadow_map", "first_blocker", "quantized", "continuous", "concave_hull")
ENDINGS = (".bin", ".pcd", ".ply", ".npy", ".npz", ".feather")
TOLD = ("table", "rings", "nothing")
ENOUGH = 0.999
ATTACKED_EVERY = 3
_VISIBLE = (1, 2)  # FREE and SURFACE
_WORST = 8

INTRODUCTION = """\
Both versions read the same files: every real sweep that is at hand, and simulated ones (own and wild worlds; with beam
table, with rings alone, or points alone; every third attacked, by each of the attacks in turn). *Same states*: share of
the cells of the grid whose state (free, surface, hidden, unknown) is the same. *F1*: of the visible cells of one
version against those of the other. *All alike*: share of the sweeps in which no cell differs."""


def write_simulated(folder: Path, count: int) -> None:
    """Write simulated sweeps, every third attacked, into a folder."""
    from viewshed import write_sweep
    from viewshed_lab.data.wild import wild_samples
    from viewshed_lab.threats.attacks import ATTACKS, EARLIER

    attacks = itertools.cycle(sorted(ATTACKS.keys() - EARLIER))
    own = max(1, count // 6)  # sweeps, each in three ways
    samples = itertools.chain(
        wild_samples("own", "road", TOLD, count=own), wild_samples("training", "road", TOLD, count=count)
    )
    for number, sample in enumerate(itertools.islice(samples, count)):
        sweep, name = sample.sweep, "clean"
        if number % ATTACKED_EVERY == 0:
            attacked = next(attacks)
            try:
                sweep = ATTACKS[attacked]().apply(sample.sweep, np.random.default_rng(number)).sweep
                name = attacked
            except ValueError:  # this attack needs beams that the sweep does not tell
                pass
        write_sweep(sweep, folder / f"{number:04d}_{name}.npz")


def answer(listed: Path, out: Path) -> None:
    """Write the states (cells, cells) of each file and method that this process's version gives."""
    import viewshed

    estimators = {method: viewshed.load_estimator(method) for method in METHODS}
    states: dict[str, np.ndarray[tuple[int, ...], np.dtype[np.uint8]]] = {}
    for path in listed.read_text(encoding="utf-8").splitlines():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                sweep = viewshed.read_sweep(path)
        except (ValueError, OSError, ImportError):
            continue
        for method, estimator in estimators.items():
            states[f"{path}|{method}"] = estimator.estimate(sweep).state
    np.savez_compressed(out, allow_pickle=False, **states)


def compare(now: Path, before: Path) -> dict[tuple[str, str], list[tuple[float, float, str]]]:
    """Return same states, F1 and file of each sweep by kind (real, simulated, attacked) and method."""
    found = defaultdict(list)
    with np.load(now) as ours, np.load(before) as theirs:
        if sorted(ours) != sorted(theirs):
            raise SystemExit("the versions did not read the same files")
        for key in ours:
            path, method = key.split("|")
            a, b = ours[key], theirs[key]
            seen_a, seen_b = np.isin(a, _VISIBLE), np.isin(b, _VISIBLE)
            total = int(seen_a.sum() + seen_b.sum())
            f1 = 2 * int((seen_a & seen_b).sum()) / total if total else 1.0
            name = Path(path).stem
            is_simulated = name[:4].isdigit() and path.endswith(".npz")
            kind = "real" if not is_simulated else "simulated" if name.endswith("clean") else "simulated, attacked"
            found[kind, method].append((float((a == b).mean()), f1, name))
    return found


def main() -> int:
    """Run both versions, compare, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="the other version")
    parser.add_argument("--simulated", type=int, default=1000)
    data = Path(os.environ.get("VIEWSHED_REAL_DATA", ROOT.parent / "shared" / "data"))
    parser.add_argument("--data", type=Path, default=data, help="folder of real sweeps")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--answer", nargs=2, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer:
        answer(*given.answer)
        return 0
    from viewshed_lab._page import commit_of, facts, page, table

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "simulated").mkdir()
        write_simulated(folder / "simulated", given.simulated)
        files = [each for each in sorted(given.data.rglob("*")) if each.name.endswith(ENDINGS)]
        files += sorted((folder / "simulated").iterdir())
        (folder / "files").write_text("\n".join(map(str, files)), encoding="utf-8")
        runs = [
            subprocess.Popen(
                (sys.executable, __file__, str(checkout), "--answer", folder / "files", folder / f"{k}.npz"),
                env=environment_of(checkout),
            )
            for k, checkout in enumerate((ROOT, given.checkout))
        ]
        if sum(abs(run.wait()) for run in runs):
            raise SystemExit("a version failed")
        found = compare(folder / "0.npz", folder / "1.npz")
    rows, worst = [], []
    for (kind, method), sweeps in sorted(found.items()):
        same, f1, _ = (np.array(column) for column in zip(*sweeps, strict=True))
        cells = [f"`{method}`", kind, str(len(sweeps)), f"{100 * same.mean():.4f} %", f"{f1.mean():.5f}"]
        rows.append([*cells, f"{100 * (same == 1).mean():.0f} %", f"{100 * same.min():.2f} %"])
        worst += [(each[0], method, kind, each[2]) for each in sweeps]
        print(" | ".join(rows[-1]), flush=True)
    lines = [f"- {100 * same:.2f} %: `{method}`, {kind}, {file}" for same, method, kind, file in sorted(worst)[:_WORST]]
    if given.out is not None:
        header = ["method", "sweeps", "number", "same states", "F1", "all alike", "worst sweep"]
        provenance = facts(
            command=f"`python tools/same_answers.py CHECKOUT --simulated {given.simulated}`",
            other=f"viewshed at {commit_of(given.checkout)}",
        )
        parts = (INTRODUCTION, table(header, rows), "The sweeps that differ most:", "\n".join(lines))
        given.out.write_text(page("Same answers", provenance, *parts), encoding="utf-8")
    else:
        print("\n".join(lines))
    return int(any(np.mean([each[0] for each in sweeps]) < ENOUGH for sweeps in found.values()))


if __name__ == "__main__":
    sys.exit(main())
