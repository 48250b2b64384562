"""The overview of the pages of results: a line for each, with its first number, and whether its code is an older one.

    python tools/results_index.py                  # writes the tables of docs/results/index.md anew
    python tools/results_index.py --rebind COMMIT  # after a change that only moves code since COMMIT
    python tools/results_index.py --bind PAGE COMMIT  # of a page whose stored results were measured at COMMIT

What stands above the line ``<!-- pages -->`` is written by hand. Groups, titles and the files and folders that a page
depends on come from ``result_pages.toml`` of ``viewshed_lab``, the numbers from the pages. A page holds a hash of its
files as they were when it was made: where they differ now, the page is older than the code. ``--rebind`` gives the hash
of now to the pages that were not older at COMMIT, ``--bind`` gives a page the hash at COMMIT.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

from viewshed_lab._page import sources_hash, table
from viewshed_lab._results import result_pages, sources_in

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "results"
MARK = "<!-- pages -->"
LOG = "wild_openings"
"""A log, without figures at its top."""
OLDER = "older"
_BOUND = re.compile(r"^- sources: (\w+)$", re.MULTILINE)


def overview(folder: Path) -> str:
    """Return the tables of the overview of the pages in a folder, one table per group."""
    groups: dict[str, list[list[str]]] = {}
    for page in result_pages().values():
        now = sources_hash(page.sources)
        for name in page.files:
            text = (folder / f"{name}.md").read_text(encoding="utf-8")
            first = re.search(r"^- (.*)$", text, re.MULTILINE)
            number = first[1] if first and name != LOG else ""
            bound = _BOUND.search(text)
            is_older = now and bound and bound[1] != now
            made = re.search(r"^- date: (\S+)", text, re.MULTILINE)
            age = f"{OLDER}, of {made[1]}" if is_older and made else OLDER if is_older else ""
            groups.setdefault(page.group, []).append([f"[{page.title}]({name}.md)", number, age])
    parts = [f"## {group}\n\n{table(['page', 'its first number', 'code'], rows)}" for group, rows in groups.items()]
    return "\n\n".join(parts) + "\n"


def with_overview(index: str) -> str:
    """Return the page of the overview with updated tables."""
    above, mark, _ = index.partition(MARK)
    if not mark:
        raise ValueError(f"index.md must have a line {MARK}")
    return f"{above}{MARK}\n\n{overview(FOLDER)}"


def rebind(commit: str) -> list[str]:
    """Bind the pages that were up to date at a commit to the current files; return their names."""
    paths = _git("ls-tree", "-r", "--name-only", commit).splitlines()
    (settings,) = [path for path in paths if path.endswith("/result_pages.toml")]
    then = sources_in(_git("show", f"{commit}:{settings}"))
    bound = []
    for page in result_pages().values():
        before, now = sources_hash(then.get(page.title, []), commit), sources_hash(page.sources)
        for name in page.files if before and now else ():
            path = FOLDER / f"{name}.md"
            old = [other for other in paths if other.endswith(f"docs/results/{name}.md")]
            was = _BOUND.search(_git("show", f"{commit}:{old[0]}")) if old else None
            if was and was[1] == before:
                path.write_text(_BOUND.sub(f"- sources: {now}", path.read_text(encoding="utf-8")), encoding="utf-8")
                bound.append(name)
    return bound


def bind(name: str, commit: str) -> None:
    """Bind a page to the files as they were at a commit."""
    [page] = [page for page in result_pages().values() if name in page.files]
    path, then = FOLDER / f"{name}.md", sources_hash(page.sources, commit)
    path.write_text(_BOUND.sub(f"- sources: {then}", path.read_text(encoding="utf-8")), encoding="utf-8")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def main() -> int:
    """Write the overview; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rebind", metavar="COMMIT", help="bind pages whose code only moved since this commit")
    parser.add_argument("--bind", nargs=2, metavar=("PAGE", "COMMIT"), help="bind a page to the files at a commit")
    arguments = parser.parse_args()
    if arguments.bind:
        bind(*arguments.bind)
    if arguments.rebind:
        print(f"bound to the files of now: {', '.join(rebind(arguments.rebind)) or 'none'}")
    index = FOLDER / "index.md"
    index.write_text(with_overview(index.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"{index.read_text(encoding='utf-8').count(f'| {OLDER}')} pages are older than the code")
    return 0


if __name__ == "__main__":
    sys.exit(main())
