"""Copy the files for trust between agents from a study into the package: ``python tools/ship_trust.py STUDY``.

``honest.json``: model of honest agents. ``limits.json``: limits of the evidence against honest agents.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from viewshed._files import write_atomic
from viewshed_lab.studies.agents.page import AgentsResults
from viewshed_lab.studies.agents.plan import HONEST_MODEL, AgentsPlan
from viewshed_lab.studies.store import PLAN, ResultStore

AGENTS = Path(__file__).parents[1] / "packages/viewshed/src/viewshed/agents"


def main() -> None:
    """Write the files."""
    study = Path(sys.argv[1])
    plan = AgentsPlan.from_json(json.loads((study / PLAN).read_text(encoding="utf-8"))["plan"])
    limits = AgentsResults(plan, ResultStore.open(study, plan).results("run")).limits
    write_atomic(AGENTS / "limits.json", limits.to_json().encode())
    write_atomic(AGENTS / HONEST_MODEL, (study / HONEST_MODEL).read_bytes())
    print(f"limits of {len(limits.score)} scenes, highest score {limits.score[-1]:.2f}")


if __name__ == "__main__":
    main()
