"""Commands of the laboratory; ``viewshed`` finds them by the entry points ``viewshed.commands``."""
