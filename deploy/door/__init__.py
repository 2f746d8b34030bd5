"""The users' door: the only process of a running car that strangers can reach."""
