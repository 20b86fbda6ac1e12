"""Pictures as bytes and as pixels; no palette."""
