"""Rectangles, poses, the camera, and 3D boxes in the image."""
