"""From a command to a program: what is sure by its words, over the intent parser."""
