"""Many agents: what they send each other, signed; what they see together, and whom to trust."""
