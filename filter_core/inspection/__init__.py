"""Looks at a folder of frames, and says how it is understood, before anything runs."""
