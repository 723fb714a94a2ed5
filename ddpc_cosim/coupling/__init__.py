"""Several plants and their connections as one plant."""
