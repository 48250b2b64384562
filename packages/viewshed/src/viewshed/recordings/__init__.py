"""Read recordings of other projects, and write our own."""
