"""What acts on a plant over time, what is wanted of it, what is known of it ahead, and what it costs."""
