"""Guarantees: an envelope that added returns only shrink, certificates against attacks, masks with bounded error."""
