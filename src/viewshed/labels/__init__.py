"""Labels: what each sweep of a benign recording could have seen, told afterwards from it and its neighbors in time."""

from viewshed.labels.labeller import DEFINITIONS, Rules, label_sweep
from viewshed.labels.run import Origin, label
from viewshed.labels.track import Track

__all__ = ["DEFINITIONS", "Origin", "Rules", "Track", "label", "label_sweep"]
