"""What a cheaper simulation changes."""
