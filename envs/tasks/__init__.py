"""The Gymnasium environments and what tasks are made of."""
