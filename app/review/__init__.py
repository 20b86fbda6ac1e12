"""Answers of people: given, undone, carried over; and the queue of boxes to review."""
