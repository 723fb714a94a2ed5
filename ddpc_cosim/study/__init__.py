"""Studies: many closed loops, from a TOML file to results on disk."""
