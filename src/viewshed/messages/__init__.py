"""What agents send each other: a view in few bytes, signed; and what a receiver makes of it."""
