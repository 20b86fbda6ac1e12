"""What there is: datasets, their classes, configurations, and frames by key."""
