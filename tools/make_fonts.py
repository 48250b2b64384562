"""Make the fonts of pictures: ``python tools/make_fonts.py`` subsets matplotlib's DejaVu Sans to the needed characters.

Latin, Greek and Cyrillic letters, arrows, and the mathematical signs in titles: 62 KB per font instead of 740 KB.
"""

import shutil
import sys
from pathlib import Path

import matplotlib as mpl
from fontTools import subset

FOLDER = Path(__file__).parents[1] / "packages/viewshed/src/viewshed/show/fonts"
CHARACTERS = (
    "U+0020-007E,U+00A0-024F,U+0370-03FF,U+0400-045F,U+2010-2026,U+2030,U+20AC,U+2190-2193,U+2212,U+2248,U+2260,"
    "U+2264-2265,U+FFFD"
)


def main() -> None:
    """Write the fonts and their license into the package."""
    source = Path(mpl.get_data_path()) / "fonts" / "ttf"
    for name in ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf"):
        subset.main([
            str(source / name), f"--unicodes={CHARACTERS}", f"--output-file={FOLDER / name}", "--no-hinting",
            "--notdef-outline", "--no-recalc-timestamp", "--drop-tables+=FFTM,GPOS,GSUB,GDEF",
        ])  # fmt: skip
        sys.stdout.write(f"{name}: {(FOLDER / name).stat().st_size} bytes\n")
    shutil.copy(source / "LICENSE_DEJAVU", FOLDER)


if __name__ == "__main__":
    main()
