"""Background jobs: queueing, driving, watching and cancelling them."""
