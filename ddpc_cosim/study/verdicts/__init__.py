"""What is concluded of runs: of one, of a problem, of all problems."""
