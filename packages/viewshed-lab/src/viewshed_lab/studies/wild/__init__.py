"""In the wild: every estimator on worlds, sensors and mountings that it was not made for, against exact truth."""
