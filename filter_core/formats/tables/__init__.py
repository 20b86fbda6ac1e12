"""Tables and long lists: their rows, fields, boxes, cameras, and patterns of paths."""
