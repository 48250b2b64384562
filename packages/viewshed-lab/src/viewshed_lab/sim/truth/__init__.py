"""Exact field of view of simulated sweeps."""
