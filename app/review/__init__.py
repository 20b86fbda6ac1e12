"""Answers of people: given, taken back, carried over, and what to look at next."""
