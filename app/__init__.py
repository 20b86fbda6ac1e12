"""The service: HTTP in, decisions stored and explained."""
