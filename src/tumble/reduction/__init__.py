"""A log reduced to rests and turns: blocks, segmentation, matching, observations, noise."""
