"""Datasets: creating, changing, describing and deleting them."""
