"""Data folders beside the service: backup, restore, doctor, clearing away."""
