"""Labels: what each sweep of a benign recording could have seen, from it and its neighbors in time."""

from __future__ import annotations

from viewshed_lab.data.labeling.labeler import DEFINITIONS, LabeledDrive, LabelRules, label_sweep
from viewshed_lab.data.labeling.run import Origin, label

__all__ = ["DEFINITIONS", "LabelRules", "LabeledDrive", "Origin", "label", "label_sweep"]
