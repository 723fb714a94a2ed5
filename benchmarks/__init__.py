"""What is measured against the obvious alternatives: ``python -m benchmarks NAME``."""
