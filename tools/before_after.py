"""Estimates of two versions side by side: ``python tools/before_after.py BEFORE AFTER --out before_after.png``.

Both folders hold NPZ files of the same names, as each version writes them with
``viewshed estimate FILE ... --results npz --out FOLDER``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from viewshed._files import write_atomic
from viewshed.io.export import read_npz
from viewshed.plot import Panel, contact_sheet


def panels_of(before: Path, after: Path) -> list[Panel]:
    """Return the panels of all estimates of ``after``, that of ``before`` ahead of each.

    Raises:
        ValueError: there is none, or one has no counterpart.
    """
    names = sorted(path.name for path in after.glob("*.npz"))
    missing = [name for name in names if not (before / name).is_file()]
    if not names or missing:
        raise ValueError(f"{before} must hold an estimate for each of {after}, misses {', '.join(missing) or 'all'}")
    panels = []
    for name in names:
        for when, folder in (("before", before), ("after", after)):
            estimate = read_npz(folder / name)
            about = f"{estimate.method}, {estimate.area_m2():.0f} m² visible"
            panels.append(Panel(estimate, f"{when}: {name.removesuffix('.npz')[-40:]}\n{about}"))
    return panels


def main() -> None:
    """Read and draw."""
    parser = argparse.ArgumentParser(prog="before_after.py", description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results/before_after.png"))
    chosen = parser.parse_args()
    write_atomic(chosen.out, contact_sheet(panels_of(chosen.before, chosen.after), across=4, side=330))


if __name__ == "__main__":
    main()
