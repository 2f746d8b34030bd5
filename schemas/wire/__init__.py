"""What travels, on which topic, and in which bytes."""
