"""Label formats and folder layouts: the only file access of the package."""
