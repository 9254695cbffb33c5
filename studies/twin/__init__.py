"""Renders the stripe camera's scenes with a path tracer of others and compares."""
