"""Record the answers of a pipeline and their sweeps, to bags and for viewers."""
