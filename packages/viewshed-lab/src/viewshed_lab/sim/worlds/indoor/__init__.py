"""Worlds inside buildings."""
