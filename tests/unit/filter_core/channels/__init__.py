"""Evidence beyond the segmentation."""
