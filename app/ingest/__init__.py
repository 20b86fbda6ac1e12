"""Ingestion of frames, one or many: checking, measuring and storing them."""
