"""Procedural anatomy: closed surfaces of organs and what lies around them, with textures, a seed each."""
