"""The client of the REST API, sending and following calls."""
