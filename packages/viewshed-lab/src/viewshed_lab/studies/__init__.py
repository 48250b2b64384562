"""Studies of estimators: the published one, robustness, the monitor, cross-view."""
