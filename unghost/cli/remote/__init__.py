"""Commands that ask a server: about its datasets, runs, boxes, access and hooks."""
