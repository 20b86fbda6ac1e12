"""All SQL of the service; one module per resource."""
