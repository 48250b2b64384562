"""Golden files: what the package answers today, against which a rebuilt one is checked.

python tools/golden.py record [arrays shards published tiny]    writes them anew; all parts if none is named
python tools/golden.py check [arrays shards published tiny]     lists what differs; exit code 1 if anything does

``tables`` names both published and tiny. ``arrays`` needs the real sweeps: VIEWSHED_REAL_DATA is their
folder, else ``shared/data`` beside the checkout.
``tiny`` runs every study on its tiny plan, which takes minutes; three of its pages come from networks trained on the
spot, so that another processor or another torch may give other figures there.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "packages" / "viewshed-lab"))

from tests.golden import parts  # noqa: E402


def main() -> int:
    """Record or check the named parts; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["record", "check"])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(parts.PARTS)}")
    arguments = parser.parse_args()
    words = arguments.parts or list(parts.PARTS)
    names = [name for word in words for name in (("published", "tiny") if word == "tables" else (word,))]
    unknown = set(names) - set(parts.PARTS)
    if unknown:
        parser.error(f"PART must be among {', '.join(parts.PARTS)}, got {', '.join(sorted(unknown))}")
    beside = ROOT.parent / "shared" / "data"
    folder = os.environ.get("VIEWSHED_REAL_DATA") or (str(beside) if beside.is_dir() else None)
    differing = 0
    for name in names:
        start = time.perf_counter()
        part = parts.PARTS[name]
        lines = [] if arguments.what == "record" else part.check(Path(folder) if folder else None)
        if arguments.what == "record":
            part.record(Path(folder) if folder else None)
        differing += len(lines)
        for line in lines:
            print(f"  {line}")
        print(f"{arguments.what} {name}: {len(lines)} differences, {time.perf_counter() - start:.0f} s")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
