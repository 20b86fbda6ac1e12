"""Quality: how well filter, people and kinds of evidence agree with the truth."""
