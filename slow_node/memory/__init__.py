"""The memory bank and the examples it begins with."""
