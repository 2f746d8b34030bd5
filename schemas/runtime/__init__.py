"""A node's life: bus, clock, process, scheduling."""
