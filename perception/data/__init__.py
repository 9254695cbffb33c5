"""Data sets of frames and of pairs, as stores and in memory."""
