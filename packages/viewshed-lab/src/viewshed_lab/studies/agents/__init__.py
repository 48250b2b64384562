"""The study of many agents: who lies, found without convicting the innocent; what all of them see together."""
