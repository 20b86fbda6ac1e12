"""The Python client of the REST API: its calls, transport, jobs and uploads."""
