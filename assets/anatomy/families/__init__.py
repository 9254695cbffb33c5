"""The families of anatomy, a builder a module."""
