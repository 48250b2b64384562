"""Assets of worlds: buildings, vehicles, furniture, street and warehouse objects."""
