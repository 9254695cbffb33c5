"""Calibrates cameras, projector and arm in the simulator, and compares with the truth."""
