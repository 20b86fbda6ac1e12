"""Records frames from a running CARLA simulator: synchronous, complete, restored."""
