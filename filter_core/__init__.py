"""Decide which boxes the camera can see. Arrays in, numbers and verdicts out."""
