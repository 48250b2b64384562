"""How well the monitor's scores tell attacked sweeps from benign ones."""
