"""Write what trust between agents needs into the package, from a study: ``python tools/ship_trust.py STUDY``.

``claims.json``: what a claim of visibility is worth. ``honest.json``: what honest agents report. ``suspicion.json``:
how rare evidence and checks of views are where nobody lies. ``limits.json``: how suspicious honest agents become.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from viewshed._files import write_atomic
from viewshed_lab.studies.agents.jobs import CLAIMS, HONEST_MODEL
from viewshed_lab.studies.agents.page import AgentsResults
from viewshed_lab.studies.agents.plan import AgentsPlan
from viewshed_lab.studies.store import PLAN, ResultStore

FUSION = Path(__file__).parents[1] / "packages/viewshed/src/viewshed/agents"


def main() -> None:
    """Write the files."""
    study = Path(sys.argv[1])
    head = json.loads((study / PLAN).read_text(encoding="utf-8"))
    plan = AgentsPlan.from_json(head["plan"])
    results = AgentsResults(plan, ResultStore.open(study, plan).results("run"))
    limits = results.limits
    write_atomic(FUSION / "limits.json", limits.to_json().encode())
    write_atomic(FUSION / "suspicion.json", results.suspicion.to_json().encode())
    for name in (CLAIMS, HONEST_MODEL):
        write_atomic(FUSION / name, (study / name).read_bytes())
    largest = limits.low[-1], limits.elevated[-1]
    print(f"limits of {len(limits.low)} scenes, most suspicious {largest[0]:.2f} and {largest[1]:.2f}")


if __name__ == "__main__":
    main()
