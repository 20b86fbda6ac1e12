"""Evidence beyond the segmentation: depth, instances, order of distance, LiDAR.

Each channel gives numbers per box (`filter_core.types.ChannelNumbers`) and,
like the rest of measuring, knows no threshold of a decision.
"""
