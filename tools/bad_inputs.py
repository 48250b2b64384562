"""Give viewshed the bad inputs of its tests, and count those that are answered by one clear line and exit code 2.

    python tools/bad_inputs.py [docs/results/bad_inputs.md]

The inputs and what counts as a clear answer are those of ``tests/cli/test_bad_inputs.py``. Exits with 1 where an answer
is wrong.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from tests.cli.test_bad_inputs import CASES, GROUPS, Case, fault_of  # noqa: E402

from viewshed._page import facts, page, table  # noqa: E402
from viewshed._results import write_page  # noqa: E402

ABOUT = """\
What users give by mistake, each to a command of its own. *Answered*: exit code 2, one line on standard error that
says what is wrong with what, in fewer than 900 characters; nothing is written, no input has changed. An audit of
version 0.3.0 found 84 of 88 answered so. Files that were built to do harm are [apart](hostile_files.md)."""


def answer(case: Case) -> tuple[str, float]:
    """Return what is wrong with the answer to a bad input, and how many seconds it took."""
    with TemporaryDirectory() as folder:
        begun_s = time.perf_counter()
        return fault_of(case, Path(folder)), time.perf_counter() - begun_s


def main() -> int:
    """Give them all, print or write the page; return the exit code."""
    rows, faults, slowest_s = list[list[str]](), list[str](), 0.0
    for group, cases in GROUPS.items():
        answers = {case.name: answer(case) for case in cases}
        wrong = [f"{name}: {fault}" for name, (fault, _) in answers.items() if fault]
        longest_s = max(seconds for _, seconds in answers.values())
        rows.append([group, str(len(cases)), str(len(cases) - len(wrong)), f"{longest_s:.2f}"])
        faults, slowest_s = faults + wrong, max(slowest_s, longest_s)
    rows.append(["**all**", str(len(CASES)), str(len(CASES) - len(faults)), f"{slowest_s:.2f}"])
    body = table(["bad inputs", "given", "answered", "longest, s"], rows)
    text = page("Bad inputs", facts(), ABOUT, body, *(["\n".join(f"- {fault}" for fault in faults)] if faults else []))
    if sys.argv[1:]:
        write_page(Path(sys.argv[1]), text)
    print(text)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
