"""The overview of the pages of results: a line for each, with its first number.

``python tools/results_index.py`` writes the tables of ``docs/results/index.md`` anew, below the line
``<!-- pages -->``; what stands above is written by hand. Groups and titles come from
``src/viewshed/result_pages.toml``, the numbers from the pages. It says how many words the pages of results and the
guides hold: at most 40,000 and 15,000, so that somebody reads them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from viewshed._page import table
from viewshed._results import result_pages

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results"
MARK = "<!-- pages -->"
LOG = "wild_openings"
"""A log, without numbers on its top."""
BESIDE = ("first_hour", "release", "ugv")
"""Pages that commands write as well, which stand among the guides."""


def overview(folder: Path) -> str:
    """Return the tables of the overview, one for each group, of the pages in a folder."""
    groups: dict[str, list[list[str]]] = {}
    for page in result_pages().values():
        for name in page.files:
            text = (folder / f"{name}.md").read_text(encoding="utf-8")
            title = page.title if len(page.files) == 1 else f"{page.title}: {name.replace('_', ' ')}"
            first = re.search(r"^- (.*)$", text, re.MULTILINE)
            number = first[1] if first and name != LOG else ""
            groups.setdefault(page.group, []).append([f"[{title}]({name}.md)", number])
    parts = [f"## {group}\n\n{table(['page', 'its first number'], rows)}" for group, rows in groups.items()]
    return "\n\n".join(parts) + "\n"


def words(folder: Path) -> tuple[int, int, int]:
    """Return the words of results, of pages beside them, and of guides; bars and rules of tables are none."""
    beside = {folder.parent / f"{name}.md" for name in BESIDE}
    return _words(set(folder.glob("*.md"))), _words(beside), _words(set(folder.parent.glob("*.md")) - beside)


def _words(pages: set[Path]) -> int:
    return sum(len(re.findall(r"\S*[^\s|-]\S*", page.read_text(encoding="utf-8"))) for page in pages)


def main() -> int:
    """Write the overview; return the exit code."""
    index = FOLDER / "index.md"
    above, mark, _ = index.read_text(encoding="utf-8").partition(MARK)
    if not mark:
        print(f"{index} must have a line {MARK}", file=sys.stderr)
        return 1
    index.write_text(f"{above}{MARK}\n\n{overview(FOLDER)}", encoding="utf-8")
    results, beside, guides = words(FOLDER)
    print(f"{results} words of results, {beside} of {', '.join(BESIDE)}, {guides} of guides")
    return 0


if __name__ == "__main__":
    sys.exit(main())
