"""Train and cross-validate networks. Only modules that fit a network import torch."""

from __future__ import annotations

from viewshed_lab.training.config import TrainConfig, config_names, read_config
from viewshed_lab.training.data import Fold
from viewshed_lab.training.run import Trained, train

__all__ = ["Fold", "TrainConfig", "Trained", "config_names", "read_config", "train"]
