"""Tracks, views and reports of one sensor or of many, held against each other."""
