"""From a log to a plant: models in innovation form, how sure they are, and a plant that plays them."""
