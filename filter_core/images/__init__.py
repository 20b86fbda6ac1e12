"""Images as files and as pixels; no palettes."""
