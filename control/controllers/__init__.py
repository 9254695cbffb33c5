"""One controller a task, on one base."""
