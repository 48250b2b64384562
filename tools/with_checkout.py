"""Run Python with the viewshed of a checkout, also where another one is installed to be edited.

    python tools/with_checkout.py CHECKOUT FILE.py …     # or -m MODULE …, or -c CODE …

CHECKOUT holds a viewshed with its built core beside its sources, as it is laid out now or up to version 0.3. Processes
that are started from there import it as well.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

_STARTUP = Path(__file__).with_name("startup")


def sources_of(checkout: Path) -> list[Path]:
    """Return the folders of a checkout that packages are imported from."""
    folders = [checkout / "packages" / name / "src" for name in ("viewshed", "viewshed-lab")]
    return folders if folders[0].is_dir() else [checkout / "src"]


def environment_of(checkout: Path) -> dict[str, str]:
    """Return the environment of a process that imports viewshed from a checkout."""
    paths = [str(_STARTUP), *map(str, sources_of(checkout.resolve())), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def main() -> None:
    """Become the Python that the command line describes."""
    if len(sys.argv) < 3 or not (sources_of(Path(sys.argv[1]))[0] / "viewshed").is_dir():
        raise SystemExit(
            "usage: python tools/with_checkout.py CHECKOUT FILE.py …; CHECKOUT must have viewshed's sources"
        )
    os.execve(sys.executable, (sys.executable, *sys.argv[2:]), environment_of(Path(sys.argv[1])))


if __name__ == "__main__":
    main()
