"""How right verdicts are, how far people agree, and which thresholds fit answers."""
