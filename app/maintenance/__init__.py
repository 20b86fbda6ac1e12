"""Commands for a data folder: backup, restore, doctor, garbage collection."""
