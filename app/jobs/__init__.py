"""Work in the background: asked for, driven chunk by chunk, watched, cancelled."""
