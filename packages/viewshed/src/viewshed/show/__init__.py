"""Pictures, pages and viewers of estimates."""
