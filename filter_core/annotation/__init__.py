"""The annotation of a frame: from JSON to rectangles."""
