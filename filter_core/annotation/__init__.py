"""What came with a frame, from JSON to rectangles."""
