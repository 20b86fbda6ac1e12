"""The methods of `Client`, one module per resource of the API."""
