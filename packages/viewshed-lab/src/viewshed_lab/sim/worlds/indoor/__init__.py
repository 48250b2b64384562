"""The worlds inside buildings."""
