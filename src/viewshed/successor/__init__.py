"""What each part of viewshed's own network is worth: ``viewshed reproduce successor``."""
