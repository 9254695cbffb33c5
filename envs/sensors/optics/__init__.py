"""Optical models of the stripe camera, as numbers and tables."""
