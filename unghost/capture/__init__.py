"""Records frames from a running CARLA simulator, and puts it back as it was."""
