"""Pictures, pages and viewers of what was estimated."""
