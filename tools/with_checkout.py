"""Run Python with the viewshed of a checkout, also where another one is installed to be edited.

    python tools/with_checkout.py CHECKOUT FILE.py …     # or -m MODULE …, or -c CODE …

CHECKOUT holds a viewshed with its built core in ``src``. Processes that are started from there import it as well.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

_STARTUP = Path(__file__).with_name("startup")


def environment_of(checkout: Path) -> dict[str, str]:
    """Return the environment of a process that imports viewshed from a checkout."""
    paths = [str(_STARTUP), str(checkout.resolve() / "src"), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def main() -> None:
    """Become the Python that the command line describes."""
    if len(sys.argv) < 3 or not Path(sys.argv[1], "src", "viewshed").is_dir():
        raise SystemExit("usage: python tools/with_checkout.py CHECKOUT FILE.py …; CHECKOUT must have src/viewshed")
    os.execve(sys.executable, (sys.executable, *sys.argv[2:]), environment_of(Path(sys.argv[1])))


if __name__ == "__main__":
    main()
