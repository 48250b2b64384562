"""The exact field of view of a simulated sweep."""
