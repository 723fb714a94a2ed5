"""Tables of the page: what a table is, and those of controllers, of cases and of settings."""
