"""A synthetic street with known truth: images, tags, boxes, and which are ghosts."""
