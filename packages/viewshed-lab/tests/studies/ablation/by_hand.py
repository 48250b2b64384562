"""Results of the ablation whose scores are known."""

from collections.abc import Mapping

import numpy as np

from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.ablation.plan import AblationPlan
from viewshed_lab.studies.ablation.results import SettingResults
from viewshed_lab.studies.records import SEVERAL, VIEW, WEDGE, Case, Results, Row, Series, row_of


def scores(right: int, wrong: int) -> Scores:
    """Claims with a probability of .9, of which so many are right and wrong."""
    found = Scores()
    found.add(np.full(right + wrong, 0.9, np.float32), np.arange(right + wrong) < right)
    return found


Claims = tuple[int, int]
"""Right and wrong claims."""


def setting_results(
    methods: Mapping[str, Mapping[Case, Claims]],
    setting: str = "viewnet_road",
    wedges: Mapping[tuple[str, Case], Claims] | None = None,
    parts: Mapping[tuple[str, Case, str], ConfusionCounts] | None = None,
    sweeps: int = 1,
) -> SettingResults:
    """Return results of claims in the view and, the same if not given, in the wedge."""
    plan = AblationPlan.load("small")
    rows: list[Row] = []
    for method, cases in methods.items():
        for case, claims in cases.items():
            inside = (wedges or {}).get((method, case), claims)
            for region, (right, wrong) in ((VIEW, claims), (WEDGE, inside)):
                counts = ConfusionCounts(right, wrong, 0, 0, (right + wrong) * 0.25, sweeps)
                series = Series(setting, method, case, region)
                rows.append(row_of(series, "", SEVERAL, counts, scores(right, wrong)))
    for (method, case, part), counts in (parts or {}).items():
        rows.append(row_of(Series(setting, method, case, part), "", SEVERAL, counts))
    return SettingResults(Results.of(plan, rows), setting)
