"""Fit the detector's classifier and measure its table again: ``python tools/fit_detector.py``.

Both files go into the package. The classifier is fitted on simulated drives with seeds from ``--seed`` on (road, then
indoors), the table measured on others.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from viewshed.objects import detection_table, shape_classifier
from viewshed.objects.detector import Detector
from viewshed_lab._page import facts
from viewshed_lab.data.object_truth import indoor_sweeps, measure_table, road_sweeps
from viewshed_lab.training.shape_classifier import fit_shape_classifier

INDOOR_SEED, TABLE_SEED = 30_000, 50_000
"""Offsets of the seeds of indoor drives, and of the drives for the table."""


def main(words: Sequence[str] | None = None) -> None:
    """Fit the classifier, measure the table, and write both files."""
    parser = argparse.ArgumentParser(prog="fit_detector.py", description=__doc__)
    parser.add_argument("--seed", type=int, default=10_000, help="of the first drive; from 0 to 10000")
    parser.add_argument("--drives", type=int, default=400, help="on roads; a sixth as many indoors")
    parser.add_argument("--classifier", type=Path, default=shape_classifier.SHIPPED)
    parser.add_argument("--table", type=Path, default=detection_table.SHIPPED)
    parser.add_argument("--keep", action="store_true", help="keep the classifier and measure the table alone")
    arguments = parser.parse_args(words)
    indoors, seed = max(arguments.drives // 6, 1), arguments.seed
    if not arguments.keep:
        training = chain(road_sweeps(seed, arguments.drives), indoor_sweeps(seed + INDOOR_SEED, indoors))
        fit_shape_classifier(training, seed).save(arguments.classifier)
    detector = Detector(classifier=shape_classifier.ShapeClassifier.load(arguments.classifier))
    seed += TABLE_SEED
    about = facts(
        worlds=f"{arguments.drives} road drives with seeds from {seed}, {indoors} indoors from {seed + INDOOR_SEED},"
        " two sweeps each, clear weather"
    )
    sweeps = chain(road_sweeps(seed, arguments.drives), indoor_sweeps(seed + INDOOR_SEED, indoors))
    table = measure_table(detector, sweeps, about)
    table.save(arguments.table)
    print(f"{table.sweeps} sweeps, {table.total.sum()} objects, {table.found.sum()} found")


if __name__ == "__main__":
    main()
