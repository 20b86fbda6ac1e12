"""The process: its startup and shutdown, its HTTP server and its connections."""
