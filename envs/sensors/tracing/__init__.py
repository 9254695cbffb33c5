"""Scenes as triangles, and the rays that walk through them."""
