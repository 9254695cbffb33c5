"""Rhythms of the tissue: models, filters and what they predict."""
