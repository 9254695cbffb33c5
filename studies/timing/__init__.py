"""Times stages, models and whole loops."""
