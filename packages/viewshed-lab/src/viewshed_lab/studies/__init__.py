"""Studies of estimators: the published one, robustness, the network's ablation, the monitor, cross-view."""
