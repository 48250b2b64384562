"""Records of counts that are known."""

from collections.abc import Iterator, Mapping, Sequence

from viewshed.metrics import ConfusionCounts
from viewshed_lab.studies.records import STRICT, UNTOUCHED, VIEW, WEDGE, Case, Record, Series

REGIONS = (VIEW, WEDGE, UNTOUCHED)
CELL_M2 = 0.25


def records(
    domain: str,
    number: int,
    case: Case,
    cells: Mapping[str, Sequence[Sequence[int]]],
    auprc: Mapping[str, float] | None = None,
    protocol: str = STRICT,
    scene: str = "",
) -> Iterator[Record]:
    """Yield records of one sweep: by method the cells (both, over, under, neither) of up to three regions."""
    for method, regions in cells.items():
        for region, (both, over, under, neither) in zip(REGIONS, regions, strict=False):
            counts = ConfusionCounts(both, over, under, neither, (both + over + under + neither) * CELL_M2)
            areas = {"auprc": auprc[method]} if region == VIEW and auprc and method in auprc else {}
            series = Series(domain, method, case, region, protocol)
            yield Record(series, scene or f"s{number}", number, counts, numbers=areas)


def refused(domain: str, number: int, case: Case, reason: str) -> Record:
    """Return the record of a case that could not be made."""
    return Record(Series(domain, "", case), f"s{number}", number, refused=reason)
