"""A phantom from a user's own file: read, checked, filled with tetrahedra."""
