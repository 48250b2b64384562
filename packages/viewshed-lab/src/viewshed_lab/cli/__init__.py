"""Research commands; ``viewshed`` loads them by the entry points ``viewshed.commands``."""
