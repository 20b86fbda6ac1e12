"""How well the filter, the people and the kinds of evidence agree with the truth."""
