"""Attacks and corruptions of sweeps, detections and fields of view, and defenses against them."""
