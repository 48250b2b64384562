"""Result rows with known counts."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from viewshed.metrics import ConfusionCounts
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.records import STRICT, UNTOUCHED, VIEW, WEDGE, Case, Row, Series, row_of
from viewshed_lab.studies.store import ResultStore

REGIONS = (VIEW, WEDGE, UNTOUCHED)
CELL_M2 = 0.25


def rows(
    domain: str,
    number: int,
    case: Case,
    cells: Mapping[str, Sequence[Sequence[int]]],
    auprc: Mapping[str, float] | None = None,
    protocol: str = STRICT,
    scene: str = "",
) -> Iterator[Row]:
    """Yield rows of one sweep: by method the cells (both, over, under, neither) of up to three regions."""
    for method, regions in cells.items():
        for region, (both, over, under, neither) in zip(REGIONS, regions, strict=False):
            counts = ConfusionCounts(both, over, under, neither, (both + over + under + neither) * CELL_M2)
            areas: dict[str, Any] = {"auprc": auprc[method]} if region == VIEW and auprc and method in auprc else {}
            series = Series(domain, method, case, region, protocol)
            yield row_of(series, scene or f"s{number}", number, counts, None, **areas)


def refused(domain: str, number: int, case: Case, reason: str) -> Row:
    """Return the row of a case that could not be simulated."""
    return row_of(Series(domain, "", case), f"s{number}", number, refused=reason)


def stored(store: ResultStore[Any]) -> dict[JobKey, tuple[str, str]]:
    """Return the result and facts of each finished job, without the commits of the code."""
    frames = {key: pd.read_parquet(store.path_of(key)) for key in sorted(store.keys())}
    return {key: (frame.to_json(), repr(frame.attrs["facts"])) for key, frame in frames.items()}
