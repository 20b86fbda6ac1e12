"""The client of the REST API: describes its calls, sends them, follows jobs."""
