"""Pictures of the reproduced study."""
