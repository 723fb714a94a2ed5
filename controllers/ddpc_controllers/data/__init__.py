"""What recordings become: Hankel matrices, windows, dictionaries, and data that follow the plant."""
