"""The one kind of process for code that may crash or hang: what it may do, and what it leaves behind."""
