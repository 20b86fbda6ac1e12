"""How the service stands: health, readiness, what is measured of it."""
