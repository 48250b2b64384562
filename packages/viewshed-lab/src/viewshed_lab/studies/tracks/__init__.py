"""What a field of view is worth for tracks and for trust in them: drives, attacks on objects, tables."""
