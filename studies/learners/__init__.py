"""What policies are worth in the environments for learners."""
