"""The bench's reference depth camera."""
