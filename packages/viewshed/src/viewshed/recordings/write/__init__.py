"""Recorder: answers of a pipeline, with the sweeps they were made from, as bags and for viewers."""
