"""Around the runner of a study: other machines, what would be run, where results come from."""
