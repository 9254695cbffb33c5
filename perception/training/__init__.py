"""Training of the depth networks, through Lightning, an optional extra that is imported only when a training runs."""
