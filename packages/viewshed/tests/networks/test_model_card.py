"""The model card names what is shipped, as it is shipped."""

import hashlib
import re
import runpy
from pathlib import Path

from viewshed.networks.weights import manifest

ROOT = Path(__file__).resolve().parents[4]
TOOL = runpy.run_path(str(ROOT / "tools" / "model_card.py"))


def test_the_card_in_the_docs_is_that_of_the_shipped_files(tmp_path: Path) -> None:
    TOOL["main"]([str(tmp_path / "card.md")])
    made, kept = (tmp_path / "card.md").read_text("utf-8"), TOOL["OUT"].read_text("utf-8")
    assert made.partition("\n## How it was made")[0] == kept.partition("\n## How it was made")[0]
    for name, line in manifest().items():
        assert f"| `{name}` |" in made
        assert line.sha256[:12] in made
    for prior in (ROOT / "packages" / "viewshed" / "src" / "core").glob("*_network.inc"):
        assert f"| `{prior.name}` |" in made
        assert hashlib.sha256(prior.read_bytes()).hexdigest()[:12] in made


def test_one_command_makes_the_networks_of_the_default_as_the_card_says() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    runs = re.findall(r"^\t\$\(FIT\)(fit_\w+\.py (?:make|fit) .*)$", makefile, re.MULTILINE)
    said = [command for prior in TOOL["PRIORS"] for command in TOOL["commands_of"](prior.tool)]
    assert [f"python tools/{run.replace('$(FITTED)/', '')}" for run in runs] == said
    assert len(said) == 17
