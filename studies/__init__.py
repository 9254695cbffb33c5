"""Experiments on top of the theatre. Each returns a table and draws its figure."""
