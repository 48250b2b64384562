"""Labels of benign recordings: what each sweep could have seen, from the sweep and its neighbors in time."""

from __future__ import annotations

from viewshed_lab.data.labeling.labeler import DEFINITIONS, LabeledDrive, LabelRules, label_sweep
from viewshed_lab.data.labeling.run import Origin, label

__all__ = ["DEFINITIONS", "LabelRules", "LabeledDrive", "Origin", "label", "label_sweep"]
