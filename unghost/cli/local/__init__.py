"""Commands that read a folder or the simulator here; some send a result to a server."""
