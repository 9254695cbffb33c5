"""From a pixel and a depth frame to a point, its normal and its motion."""
