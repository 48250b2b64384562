"""Networks that estimate the field of view: shapes, weights, engine."""
