"""Networks that estimate the field of view: architecture, weights, inference."""
