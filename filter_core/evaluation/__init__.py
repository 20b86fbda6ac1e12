"""How right verdicts are, and which thresholds answers speak for."""
