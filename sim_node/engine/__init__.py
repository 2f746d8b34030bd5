"""Batched simulators for training: the same world as the real-time environments, many scenes at a time."""
