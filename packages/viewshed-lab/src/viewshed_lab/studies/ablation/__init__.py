"""What each part of the network is worth, and the shipped network against the estimators."""
