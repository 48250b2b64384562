"""Things that worlds are made of: buildings, vehicles, furniture, the street and the warehouse."""
