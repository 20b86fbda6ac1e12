"""A synthetic street with known truth."""
