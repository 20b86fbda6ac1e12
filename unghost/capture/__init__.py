"""Records frames from a running CARLA simulator, and restores its state."""
