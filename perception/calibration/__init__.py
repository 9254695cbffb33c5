"""Calibration of cameras with a checkerboard: corners, intrinsics, the transform between two cameras, and a file for them."""
