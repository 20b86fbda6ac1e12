"""Reviews: storing, undoing and carrying over answers; the queue of boxes to review."""
