"""What files, tables and people say: as text that is read, and as text that is written."""
