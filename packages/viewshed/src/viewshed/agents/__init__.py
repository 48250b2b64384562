"""Multi-agent perception: signed messages, the joint field of view and tracks, and trust in each agent."""
