"""From a Sweep to a LeveledSweep: rings, sensor, range image, isolated returns, ground, no-return beams, history."""
