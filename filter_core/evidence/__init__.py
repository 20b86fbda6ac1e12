"""Measured evidence: numbers per box, from the segmentation and from other sensors.

`channels.measure_evidence` measures everything for a frame. The other modules measure
one kind of evidence each, or are shared by several kinds. Annotations, thresholds and
decisions are not used here.
"""
