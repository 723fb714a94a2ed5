"""FMUs as plants, through FMPy."""
