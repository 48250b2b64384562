"""How well a probability of visible agrees with the truth: agreement, ranking and calibration."""
