"""The one kind of process for whatever may crash or hang: what it may do, and what it leaves behind."""
