"""Record the package's results as golden files, or compare the present results with them.

python tools/golden.py record [arrays shards published tiny]    writes them; all parts if none is named
python tools/golden.py check [arrays shards published tiny]     lists differences; exit code 1 if there is one

``tables`` stands for published and tiny. ``arrays`` needs the real sweeps, in the folder VIEWSHED_REAL_DATA or else in
``shared/data`` beside the checkout. ``tiny`` runs every study on its tiny plan, which takes minutes; three of its pages
come from networks trained in the run, so their figures may differ with another processor or torch.
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
    shared = ROOT.parent / "shared" / "data"
    folder = os.environ.get("VIEWSHED_REAL_DATA") or (str(shared) if shared.is_dir() else None)
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
