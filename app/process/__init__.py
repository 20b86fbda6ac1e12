"""The process: what it opens and closes, and its HTTP server."""
