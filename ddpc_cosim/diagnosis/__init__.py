"""What is behind `inspect`, `init` and `check`: defects of FMUs, step tests, suggestions, conformance."""
