"""Variety for learners: parts of a task's configuration that differ from episode to episode."""
