"""Training: configuration, frames, runs, cross-validation."""
