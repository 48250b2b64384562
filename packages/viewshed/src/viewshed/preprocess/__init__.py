"""Preprocessing of a Sweep: rings, sensor, range image, isolated returns, ground, no-return beams, history."""
