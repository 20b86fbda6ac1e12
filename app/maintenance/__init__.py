"""Commands that work on a data folder: backup, restore, doctor, clearing away."""
