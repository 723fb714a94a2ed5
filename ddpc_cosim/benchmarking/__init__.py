"""Entering a benchmark: a controller on its terms, in a folder that anyone can check."""
