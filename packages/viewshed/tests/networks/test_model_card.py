"""The model card names what is shipped, as it is shipped."""

import runpy
from pathlib import Path

from viewshed.networks.weights import manifest

TOOL = runpy.run_path(str(Path(__file__).resolve().parents[4] / "tools" / "model_card.py"))


def test_the_card_in_the_docs_is_that_of_the_shipped_files(tmp_path: Path) -> None:
    TOOL["main"]([str(tmp_path / "card.md")])
    made, kept = (tmp_path / "card.md").read_text("utf-8"), TOOL["OUT"].read_text("utf-8")
    assert made.partition("\n## How it was made")[0] == kept.partition("\n## How it was made")[0]
    for name, line in manifest().items():
        assert f"| `{name}` |" in made
        assert line.sha256[:12] in made
