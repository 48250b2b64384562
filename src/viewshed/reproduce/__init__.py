"""The published study, made again by one command."""
