"""How well the monitor of all evidence holds its rates and finds attacks: drives, a score trained on them, tables."""
