"""What the service does; knows neither HTTP nor SQL."""
