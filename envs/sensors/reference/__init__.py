"""The reference depth camera of the optical bench."""
