"""Write what trust between agents needs into the package, from a study: ``python tools/ship_trust.py STUDY``.

``claims.json``: what a claim of visibility is worth. ``honest.json``: what honest agents report. ``limits.json``: how
large evidence and doubt become where nobody lies.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from viewshed._files import write_atomic
from viewshed.fusion.trust import TrustLimits
from viewshed.studies.agents.jobs import CLAIMS, HONEST_MODEL
from viewshed.studies.agents.page import AgentsResults
from viewshed.studies.agents.plan import AgentsPlan
from viewshed.studies.store import FILE, ResultStore

FUSION = Path(__file__).parents[1] / "src/viewshed/fusion"


def limits_of(study: Path) -> TrustLimits:
    """Return the limits of the calibration scenes of a study: of each the most suspicious agent of each kind."""
    head = json.loads((study / FILE).open(encoding="utf-8").readline())
    plan = AgentsPlan.from_json(head["plan"])
    results = AgentsResults(plan, ResultStore.open(study, plan).results("run"))
    runs = [run for _, run in results.runs("calibration")]
    evidence, elevated = np.array([np.max(run.evidence, axis=0) for run in runs]), results.elevated
    doubt = np.array([max(run.doubt) for run in runs])
    return TrustLimits.of(evidence[:, ~elevated].max(axis=1), evidence[:, elevated].max(axis=1), doubt)


def main() -> None:
    """Write the files."""
    study = Path(sys.argv[1])
    limits = limits_of(study)
    write_atomic(FUSION / "limits.json", limits.to_json().encode())
    for name in (CLAIMS, HONEST_MODEL):
        write_atomic(FUSION / name, (study / name).read_bytes())
    print(
        f"limits of {len(limits.low)} scenes, largest evidence {limits.low[-1]:.2f} and {limits.elevated[-1]:.2f} nats"
    )


if __name__ == "__main__":
    main()
